"""Damaged files: the readers give a problem that is one, or an error that names file and fault (see fuzz.py)."""

import collections
import sys

import pytest
from fuzz import bound, examine, given, judged, outcome_of
from mutations import MUTATIONS, seed_files

from fibercontact.problem.incremental import ProblemError

COUNT = 560  # damaged files; fewer than 500 would not do


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    return seed_files(tmp_path_factory.mktemp("fuzz") / "seeds", given())


@pytest.mark.parametrize("half", [0, 1])
def test_a_damaged_file_gives_a_problem_or_an_error_that_names_the_fault(seeds, half):
    numbers = range(half * COUNT // 2, (half + 1) * COUNT // 2)
    found = examine(seeds, numbers)
    assert [outcome for outcome in found if "fault" in outcome] == []
    assert [outcome["number"] for outcome in found] == list(numbers)
    done = {outcome["what"].split()[0] for outcome in found}
    assert done == {mutation.__name__ for mutation in MUTATIONS}
    refused = collections.Counter("refused" in outcome for outcome in found)
    assert min(refused[True], refused[False]) > 20
    if sys.platform == "linux":
        assert max(outcome["used"] for outcome in found) > 2**16  # memory is seen


def test_a_sound_file_is_read_whole(seeds, tmp_path):
    for seed in seeds:
        assert "read" in outcome_of(seed), seed


def test_refusals_are_judged(tmp_path):
    path = tmp_path / "a.hdf5"
    assert "refused" in judged(ProblemError(f"{path}: W is missing"), path)
    assert "fault" in judged(ProblemError("W is missing"), path)
    assert "fault" in judged(ProblemError(f"{path}: W\nis missing"), path)
    assert "fault" in judged(ProblemError(f"{path}: "), path)
    starved = ProblemError(f"{path}: W cannot be read")
    starved.__context__ = MemoryError()
    assert "fault" in judged(starved, path)


def test_a_process_that_dies_is_a_fault_and_the_rest_goes_on(seeds, monkeypatch):
    monkeypatch.setenv("FUZZ_WAITING_SECONDS", "1e-6")
    found = examine(seeds[:1], [3, 4])
    assert ["the process ended with -" in outcome["fault"] for outcome in found] == [True, True]


def test_the_bound_grows_with_the_file():
    assert bound(10**4) < 2**27 < bound(10**6)
