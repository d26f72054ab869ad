"""Threads: the ranges make up the whole, and no result depends on how many threads there are."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from fibercontact.contact import broad_phase, detect
from fibercontact.problem import mobility
from fibercontact.rods import dynamics, kinematics
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import simulate
from fibercontact.threads import over_ranges, thread_count, together

SIZES = [
    (dynamics, "_RODS"), (kinematics, "_RODS"), (kinematics, "_POINTS"), (broad_phase, "_SEGMENTS"),
    (detect, "_PAIRS"), (mobility, "_CONTACTS"),
]  # fmt: skip


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize(("count", "size"), [(0, 4), (1, 4), (4, 4), (9, 4)])
def test_ranges_make_up_the_whole_in_order(count, size, threads, monkeypatch):
    monkeypatch.setenv("FIBERCONTACT_THREADS", threads)
    ranges = over_ranges(lambda first, end: list(range(first, end)), count, size)
    assert [i for some in ranges for i in some] == list(range(count))
    assert all(0 < len(some) <= size for some in ranges)


def test_an_error_in_a_range_is_raised(monkeypatch):
    monkeypatch.setenv("FIBERCONTACT_THREADS", "2")
    with pytest.raises(ZeroDivisionError):
        over_ranges(lambda first, end: 1 // (first - 3), 9, 1)


@pytest.mark.parametrize("failing", [0, 1])
def test_an_error_in_one_of_several_threads_is_raised(failing):
    calls = [lambda: 1, lambda: 2]
    calls[failing] = lambda: 1 // 0
    with pytest.raises(ZeroDivisionError):
        together(calls)


def test_threads_wait_for_each_other():
    meeting = threading.Barrier(3, timeout=60)
    order = together([lambda k=k: (k, meeting.wait())[0] for k in range(3)])
    assert order == [0, 1, 2]


@pytest.mark.parametrize(("text", "count"), [("5", 5), ("0", None), ("many", None), ("", None)])
def test_the_number_of_threads(text, count, monkeypatch):
    monkeypatch.setenv("FIBERCONTACT_THREADS", text)
    assert thread_count() == count if count else thread_count() >= 1


@pytest.mark.parametrize("model", ["helix", "clothoid", "discrete"])
def test_steps_do_not_depend_on_threads_bit_for_bit(model, monkeypatch):
    scene = replace(build(Parameters("twist", 24, "mixed", 0.4, 0.3, 3, model)), steps=8)

    def run(threads):
        monkeypatch.setenv("FIBERCONTACT_THREADS", threads)
        return list(simulate(scene))

    whole = run("1")
    for module, name in SIZES:
        monkeypatch.setattr(module, name, 5)
    for one, other in zip(whole, run("3"), strict=True):
        for x, y in zip(one.world.state, other.world.state, strict=True):
            np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(one.world.impulses, other.world.impulses)
        if one.problem is not None:
            assert one.problem.condense().content_hash() == other.problem.condense().content_hash()
    assert whole[-1].problem is not None
