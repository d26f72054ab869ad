"""Work on the problems of a set by a Dask cluster that is there already: its scheduler's address is all we know.

A task is a problem. It carries the problem's hash, and its bytes come to the worker that takes it under that name,
where they are checked against it. The work is done in a process of its own there too, so a solver that hangs or
crashes costs its row and not the cluster's worker. A task whose worker dies is done again by another one.
"""

import hashlib
import tempfile
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from fibercontact.bench.environment import MEMORY_SHARE, memory_share
from fibercontact.bench.plan import code
from fibercontact.bench.problem_set import HASH_DIGITS, Entry
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.worker import Setting, Worker
from fibercontact.errors import UserError
from fibercontact.files import replace_file
from fibercontact.local.loading import with_neighbours

__all__ = ["Cluster", "Do"]

CONNECT_SECONDS = 20.0
TRIES = 10
"""How often a task is begun whose worker dies, and bytes are handed over to one that does."""
PAUSE_SECONDS = 0.5

Do = Callable[[Worker, Path, Any], Any]
"""What is done with a problem: by a worker process, with the problem's file and a parcel; to be found by its name."""


class _Order(NamedTuple):
    """What a task carries beside the problem's bytes."""

    run: str
    code: str
    setting: Setting
    sources: Mapping[str, Mapping[str, bytes]]
    """Of each plugin, by its file's name: the files that it is made of, by theirs."""
    name: str
    hash: str
    do: Do
    parcel: Any


class Cluster:
    """The workers of a scheduler, for one run. Raises `BenchError` when it is not there, or Dask is not here."""

    def __init__(self, address: str, setting: Setting, note: Callable[[str], None]) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise BenchError("--dask needs Dask: pip install 'fibercontact[dask]'") from None
        try:
            self._client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as fault:
            raise BenchError(f"no Dask scheduler at {address}: {fault}") from None
        self._address, self._note, self._run = address, note, uuid.uuid4().hex
        self._setting = setting._replace(plugins=())
        self._sources = {
            path.name: {file.name: file.read_bytes() for file in with_neighbours(path)}
            for path in setting.plugins
        }

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop what is under way, and leave."""
        with suppress(OSError, RuntimeError):  # of a cluster that has gone
            self._client.run(_end_run, self._run)
        self._client.close()

    def share_out(
        self, parcels: Mapping[Entry, Any], do: Do, take: Callable[[Entry, Any], None]
    ) -> list[str]:
        """Call `do` on the cluster for every problem and its parcel, `take` here with what it returns.

        Returns a sentence on each problem that its worker died of, time and again. Raises `BenchError` on what
        concerns all of them: workers with other sources, or without the solvers.
        """
        from distributed import as_completed

        todo, faults = deque(parcels), list[str]()
        under_way: dict[Any, Entry] = {}
        tries: Counter[Entry] = Counter()
        completed = as_completed(loop=self._client.loop)
        while todo or under_way:
            while todo and len(under_way) < self._room():
                entry = todo.popleft()
                tries[entry] += 1
                future = self._begin(self._order(entry, do, parcels[entry]), entry)
                under_way[future] = entry
                completed.add(future)
            future = next(completed)
            entry = under_way.pop(future)
            if future.status == "finished":
                take(entry, future.result())
            elif not _died(future):
                raise self._told(future.exception())
            elif tries[entry] < TRIES:
                todo.append(entry)
            else:
                faults.append(f"{entry.file}: the worker that took it died, {TRIES} times")
        return faults

    def _begin(self, order: _Order, entry: Entry) -> Any:
        """Hand the bytes of a problem to the cluster, and the task that needs them."""
        content = entry.file.read_bytes()
        # The name is new at every try: with that of an earlier one, what that one held is released, and this, too.
        key = f"fibercontact-{entry.hash}-{uuid.uuid4().hex}"
        for left in reversed(range(TRIES)):
            try:
                data = self._client.scatter({key: content})[key]
                return self._client.submit(_task, order, data, pure=False)
            except OSError as fault:  # a worker that was to have them died meanwhile
                if not left:
                    raise BenchError(f"{self._address}: {fault}") from None
                time.sleep(PAUSE_SECONDS)
        raise AssertionError

    def _order(self, entry: Entry, do: Do, parcel: Any) -> _Order:
        return _Order(
            self._run, code(), self._setting, self._sources, entry.file.name, entry.hash, do, parcel
        )

    def _room(self) -> int:
        """How many tasks may be under way: two for each thread of a worker. Waits while there is no worker."""
        while not (threads := sum(self._client.nthreads().values())):
            self._note(f"{self._address}: waiting for workers")
            self._client.submit(int, pure=False).exception()  # some clusters start workers only for a task
        return 2 * threads

    def _told(self, fault: BaseException) -> BaseException:
        """What a task raised, for the user."""
        if isinstance(fault, UserError):
            return fault
        return BenchError(f"a worker of {self._address}: {type(fault).__name__}: {fault}")


def _died(future: Any) -> bool:
    """Whether a task was lost with its worker: with the bytes that it needed, or again and again."""
    from distributed import KilledWorker

    return future.status != "error" or isinstance(future.exception(), KilledWorker)


# What follows runs in the cluster's workers.


def _task(order: _Order, data: bytes) -> Any:
    """Do what is asked with a problem, in a process of its own."""
    if code() != order.code:
        raise BenchError(f"{_here()} has another version of fibercontact, of Python or of numba")
    if (found := hashlib.sha256(data).hexdigest()[:HASH_DIGITS]) != order.hash:
        raise BenchError(f"{_here()} got {order.name} with the hash {found}, not {order.hash}")
    with _borrowed(order) as worker, tempfile.TemporaryDirectory(dir=_folder()) as folder:
        file = Path(folder, order.name)
        file.write_bytes(data)
        return order.do(worker, file, order.parcel)


def _here() -> str:
    from distributed import get_worker

    return f"the worker {get_worker().address}"


@dataclass
class _Hand:
    """A process of a run in this worker of the cluster."""

    run: str
    worker: Worker
    busy: bool = True


_hands: list[_Hand] = []
_lock = threading.Lock()


@contextmanager
def _borrowed(order: _Order) -> Iterator[Worker]:
    """A process of the run that has nothing to do, or a new one."""
    with _lock:
        for hand in [hand for hand in _hands if hand.run != order.run and not hand.busy]:
            _dismiss(hand)  # its run ended without a word
        idle = [hand for hand in _hands if hand.run == order.run and not hand.busy]
        hand = idle[0] if idle else _Hand(order.run, Worker(_setting(order)))
        hand.busy = True
        _hands.extend([] if idle else [hand])
    try:
        yield hand.worker
    finally:
        hand.busy = False


def _end_run(run: str) -> None:
    """Kill the processes of a run."""
    with _lock:
        for hand in [hand for hand in _hands if hand.run == run]:
            _dismiss(hand)


def _dismiss(hand: _Hand) -> None:
    hand.worker.end()
    _hands.remove(hand)


def _setting(order: _Order) -> Setting:
    """The setting of a process here: the plugins in files of ours, the share of memory of a thread."""
    folder = _folder() / order.run
    files = [
        _plugin(folder / str(k), name, sources) for k, (name, sources) in enumerate(order.sources.items())
    ]
    return order.setting._replace(plugins=files, memory=order.setting.memory or _memory())


def _plugin(folder: Path, name: str, sources: Mapping[str, bytes]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for file, source in sources.items():
        replace_file(folder / file, source)
    return folder / name


def _folder() -> Path:
    """Where this worker of the cluster may write."""
    from distributed import get_worker

    return Path(get_worker().local_directory)


def _memory() -> int:
    """What each thread's process may use of this worker's memory."""
    from distributed import get_worker

    worker = get_worker()
    limit, threads = worker.memory_manager.memory_limit, worker.state.nthreads
    return int(MEMORY_SHARE * limit / threads) if limit else memory_share(threads)
