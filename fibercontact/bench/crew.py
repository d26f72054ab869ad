"""Several worker processes at once, on this machine."""

import queue
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from fibercontact.bench.worker import Ended, Worker

__all__ = ["share_out"]

Job = TypeVar("Job")


def share_out(jobs: Iterable[Job], crew: Sequence[Worker], do: Callable[[Worker, Job], None]) -> None:
    """Call `do` for every job, in a thread for each worker of the crew; the workers are ended at the end.

    What a job raises is raised after the others have been stopped, and so is `KeyboardInterrupt`.
    """
    todo: queue.SimpleQueue[Job] = queue.SimpleQueue()
    for job in jobs:
        todo.put(job)
    errors: list[BaseException] = []

    def serve(worker: Worker) -> None:
        try:
            while not errors:
                do(worker, todo.get_nowait())
        except (queue.Empty, Ended):
            pass
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=serve, args=(worker,)) for worker in crew]
    try:
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) and not errors:
            time.sleep(0.05)
    finally:
        for worker in crew:
            worker.end()
        for thread in threads:
            thread.join()
        for worker in crew:
            worker.end()  # a process that was being started meanwhile
    if errors:
        raise errors[0]
