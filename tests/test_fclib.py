"""FCLIB files: round trips, every storage, bilateral constraints, and the faults of strangers' files."""

import itertools
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.sparse import block_diag, csr_array

from fibercontact.problem import fclib
from fibercontact.problem.fclib import Solution
from fibercontact.problem.incremental import IncrementalProblem, ProblemError, ProblemWarning
from fibercontact.problem.step import StepProblem

SHARED = {  # contacts of the real files, and the relative asymmetry of W where it is not rounding
    "Box_Stacks-i0122-82-5.global": (82, None),
    "BoxesStack1-i100000-32": (52, None),
    "Capsules-i100-889": (276, "6.7e-04"),
    "Capsules-i125-1213": (286, "1.3e-03"),
    "Confeti-ex03-Fc3D-SBM": (54, None),
    "Confeti-ex13-4contact-Fc3D-SBM": (4, None),
    "FC3D_Example1": (3, None),
    "FrictionContact3D_1c": (1, None),
    "FrictionContact3D_RR_1c": (1, None),
    "GFC3D_TwoRods1-condensed": (3, None),
    "LMGC_100_PR_PerioBox-i00361-60-03000": (60, None),
    "NESpheres_10_1": (9, None),
    "OneObject-i100000-316": (25, "4.5e-05"),
    "OneObject-i1028-138": (23, "1.2e-04"),
    "Rover11035": (1, "1.1e-05"),
    "Rover3865": (5, "8.1e-06"),
    "Rover4144": (4, "8.0e-06"),
}
SHARED_FILES = sorted((Path(__file__).parents[2] / "shared" / "fclib").glob("*.hdf5"))


def make_step(seed=0, n=4, rods=3, size=5):
    rng = np.random.default_rng(seed)
    blocks = [A @ A.T + np.eye(size) for A in rng.standard_normal((rods, size, size))]
    H = np.zeros((3 * n, rods * size))
    for i in range(n):
        for rod in rng.choice(rods, 2, replace=False):
            H[3 * i : 3 * i + 3, size * rod : size * (rod + 1)] = rng.standard_normal((3, size))
    return StepProblem(
        csr_array(block_diag(blocks)),
        rng.standard_normal(rods * size),
        csr_array(H),
        rng.standard_normal(3 * n),
        rng.uniform(0, 1, n),
    )


def random_solution(problem, seed):
    rng = np.random.default_rng(seed)
    v = rng.standard_normal(problem.d) if isinstance(problem, StepProblem) else None
    return Solution(v=v, u=rng.standard_normal(3 * problem.n), r=rng.standard_normal(3 * problem.n))


def put_matrix(file, name, A, nz=-1):
    """Store a dense matrix the way FCLIB's own code does."""
    A = np.asarray(A)
    if nz >= 0:  # triplets in a shuffled order; p is the column, i the row
        i, p = (index[::-1] for index in np.nonzero(A))
        x, nz = A[i, p], len(i)
    else:
        major = A.T if nz == -1 else A
        rows, i = np.nonzero(major)
        x, p = major[rows, i], np.searchsorted(rows, np.arange(len(major) + 1))
    if name in file:
        del file[name]
    group = file.create_group(name)
    for key, value in {"m": A.shape[0], "n": A.shape[1], "nz": nz, "nzmax": len(x)}.items():
        group[key] = np.array([value], dtype=np.int32)
    group["p"], group["i"], group["x"] = p.astype(np.int32), i.astype(np.int32), x


def assert_same_step(a, b):
    for name in ("M", "H"):
        np.testing.assert_array_equal(getattr(a, name).toarray(), getattr(b, name).toarray())
    for name in ("f", "w", "mu"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def assert_same_solution(a, b):
    for x, y in zip(vars(a).values(), vars(b).values(), strict=True):
        np.testing.assert_equal(x, y)


# Round trips


@pytest.mark.parametrize("kind", ["local", "global"])
def test_a_file_gives_back_what_was_written(tmp_path, kind):
    step = make_step()
    problem = step.condense() if kind == "local" else step
    guesses = [random_solution(problem, k) for k in range(3)]
    solution = random_solution(problem, 9)
    texts = {"title": "a hair", "description": "θ = 0.5", "math_info": ""}
    path = tmp_path / "a.hdf5"
    fclib.write(path, problem, guesses=guesses, solution=solution, **texts)
    file = fclib.read(str(path))
    if kind == "local":
        assert file.problem.content_hash() == problem.content_hash()
    else:
        assert_same_step(file.problem, problem)
        assert file.problem.condense().content_hash() == problem.condense().content_hash()
    for ours, theirs in zip([*guesses, solution], [*file.guesses, file.solution], strict=True):
        assert_same_solution(ours, theirs)
    assert {name: getattr(file, name) for name in texts} == texts
    assert file.path == path


def test_a_bare_file_has_no_guesses_and_no_solution(tmp_path):
    fclib.write(tmp_path / "a.hdf5", make_step())
    file = fclib.read(tmp_path / "a.hdf5")
    assert file.guesses == ()
    assert file.solution is None


def test_equal_problems_give_equal_bytes(tmp_path):
    for name in "ab":
        fclib.write(tmp_path / name, make_step(), title="t", solution=random_solution(make_step(), 1))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_layout_is_fclibs(tmp_path):
    step = make_step()
    fclib.write(tmp_path / "a.hdf5", step, title="name")
    with h5py.File(tmp_path / "a.hdf5") as file:
        main = file["fclib_global"]
        d, size = step.d, 3 * step.n
        assert (main["H/m"][0], main["H/n"][0], main["M/m"][0], main["M/n"][0]) == (d, size, d, d)
        assert {main[f"{A}/{key}"].dtype for A in "MH" for key in ("m", "n", "nz", "nzmax", "p", "i")} == {
            np.dtype(np.int32)
        }
        columns = main["H/p"][:]
        theirs = np.zeros((d, size))
        for j, (start, end) in enumerate(itertools.pairwise(columns)):
            theirs[main["H/i"][start:end], j] = main["H/x"][start:end]
        np.testing.assert_array_equal(theirs, step.H.toarray().T)
        np.testing.assert_array_equal(main["vectors/f"][:], -step.f)
        assert main["info/title"][()] == b"name"
        assert main["spacedim"][:] == [3]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "a.hdf5"
    fclib.write(path, make_step(1))
    before = path.read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fclib.write(path, make_step(2))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("solution", "fault"),
    [
        (Solution(r=np.zeros(5)), r"solution/r must have shape \(12,\)"),
        (Solution(v=np.zeros(15)), "solution/v has no place"),
        (Solution(u=np.full(12, np.nan)), "solution/u is not finite"),
        (Solution(r=np.append(np.zeros(11), np.inf)), r"solution/r is not finite \(inf\) at value 11"),
    ],
)
def test_a_solution_that_could_not_be_read_back_is_not_written(tmp_path, solution, fault):
    with pytest.raises(ProblemError, match=fault):
        fclib.write(tmp_path / "a.hdf5", make_step().condense(), solution=solution)
    assert not list(tmp_path.iterdir())


def test_a_problem_without_contacts_is_not_written(tmp_path):
    with pytest.raises(ProblemError, match="without contacts"):
        fclib.write(tmp_path / "a.hdf5", make_step(n=0))


# Storage


@pytest.mark.parametrize("nz", [0, -1, -2])
def test_every_storage_holds_the_same_local_problem(tmp_path, nz):
    problem, path = make_step().condense(), tmp_path / "a.hdf5"
    fclib.write(path, problem)
    with h5py.File(path, "r+") as file:
        put_matrix(file, "fclib_local/W", problem.W.toarray(), nz)
    assert fclib.read(path).problem.content_hash() == problem.content_hash()


@pytest.mark.parametrize("nz", [0, -1, -2])
def test_every_storage_holds_the_same_global_problem(tmp_path, nz):
    step, path = make_step(), tmp_path / "a.hdf5"
    fclib.write(path, step)
    with h5py.File(path, "r+") as file:
        put_matrix(file, "fclib_global/M", step.M.toarray(), nz)
        put_matrix(file, "fclib_global/H", step.H.toarray().T, nz)
    assert_same_step(fclib.read(path).problem, step)


def test_arrays_may_be_longer_than_their_entries(tmp_path):
    step, path = make_step(), tmp_path / "a.hdf5"
    fclib.write(path, step)
    with h5py.File(path, "r+") as file:
        H = file["fclib_global/H"]
        for key in "ix":
            longer = np.append(H[key][:], [7, 7]).astype(H[key].dtype)
            del H[key]
            H[key] = longer
        H["nzmax"][:] = len(longer)
    assert_same_step(fclib.read(path).problem, step)


def test_a_global_problem_goes_before_a_local_one(tmp_path):
    step = make_step()
    fclib.write(tmp_path / "a", step)
    fclib.write(tmp_path / "b", step.condense())
    with h5py.File(tmp_path / "a", "r+") as a, h5py.File(tmp_path / "b") as b:
        b.copy("fclib_local", a)
    assert isinstance(fclib.read(tmp_path / "a").problem, StepProblem)


# Bilateral constraints


def constrained(seed):
    """A step, FCLIB's `G` and `b`, impulses, and the contact velocities by the whole KKT system."""
    step, rng = make_step(seed), np.random.default_rng(seed + 1)
    G, b, r = rng.standard_normal((15, 4)), rng.standard_normal(4), rng.standard_normal(12)
    M, H = step.M.toarray(), step.H.toarray()
    kkt = np.block([[M, -G], [G.T, np.zeros((4, 4))]])
    v = np.linalg.solve(kkt, np.concatenate([H.T @ r - step.f, -b]))[:15]
    return step, G, b, r, H @ v + step.w


@pytest.mark.parametrize("seed", range(3))
def test_bilateral_constraints_of_a_global_problem_are_eliminated(tmp_path, seed):
    step, G, b, r, u = constrained(seed)
    path = tmp_path / "a.hdf5"
    fclib.write(path, step)
    with h5py.File(path, "r+") as file:
        put_matrix(file, "fclib_global/G", G)
        file["fclib_global/vectors/b"] = b
        solution = {"v": np.ones(15), "u": u, "r": r, "l": np.arange(4.0)}
        for name, values in solution.items():
            file[f"solution/{name}"] = values
    file = fclib.read(path)
    assert isinstance(file.problem, IncrementalProblem)
    np.testing.assert_allclose(file.problem.W @ r + file.problem.b, u, rtol=1e-8, atol=1e-8)
    assert_same_solution(file.solution, Solution(**solution))


@pytest.mark.parametrize("seed", range(3))
def test_bilateral_constraints_of_a_local_problem_are_eliminated(tmp_path, seed):
    step, G, b, r, u = constrained(seed)
    inverse, H, path = np.linalg.inv(step.M.toarray()), step.H.toarray(), tmp_path / "a.hdf5"
    fclib.write(path, step.condense())
    with h5py.File(path, "r+") as file:
        put_matrix(file, "fclib_local/V", H @ inverse @ G)
        put_matrix(file, "fclib_local/R", G.T @ inverse @ G)
        file["fclib_local/vectors/s"] = b - G.T @ inverse @ step.f
    problem = fclib.read(path).problem
    np.testing.assert_allclose(problem.W @ r + problem.b, u, rtol=1e-8, atol=1e-8)


def test_constraints_that_cannot_be_eliminated_are_refused(tmp_path):
    step, G, _, _, _ = constrained(0)
    G[:, 2] = G[:, 0] + G[:, 1]
    fclib.write(tmp_path / "global", step)
    with h5py.File(tmp_path / "global", "r+") as file:
        put_matrix(file, "fclib_global/G", G)
        file["fclib_global/vectors/b"] = np.zeros(4)
    with pytest.raises(ProblemError, match="global: G is rank deficient: bilateral constraint 2 depends"):
        fclib.read(tmp_path / "global")
    fclib.write(tmp_path / "local", step.condense())
    with h5py.File(tmp_path / "local", "r+") as file:
        put_matrix(file, "fclib_local/V", np.ones((12, 2)))
        put_matrix(file, "fclib_local/R", np.ones((2, 2)))
        file["fclib_local/vectors/s"] = np.zeros(2)
    with pytest.raises(ProblemError, match=r"R is singular \(rank 1 of 2\)"):
        fclib.read(tmp_path / "local")


def test_empty_constraints_are_none(tmp_path):
    step, path = make_step(), tmp_path / "a.hdf5"
    fclib.write(path, step)
    with h5py.File(path, "r+") as file:
        put_matrix(file, "fclib_global/G", np.zeros((15, 0)))
    assert isinstance(fclib.read(path).problem, StepProblem)


# Faults


def replaced(name, value):
    def spoil(file):
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value

    return spoil


def entry(name, at, value):
    def spoil(file):
        values = file[name][:]
        values[at] = value
        replaced(name, values)(file)

    return spoil


def matrix(name, change):
    return lambda file: put_matrix(file, name, change(file))


def int32(*values):
    return np.array(values, dtype=np.int32)


def read_dense(file, name):
    """The matrix of a CSC group, dense."""
    group = file[name]
    A = np.zeros((group["m"][0], group["n"][0]))
    for j, (start, end) in enumerate(itertools.pairwise(group["p"][:])):
        A[group["i"][start:end], j] = group["x"][start:end]
    return A


def without_contact(i):
    def change(file):
        W = read_dense(file, "fclib_local/W")
        W[3 * i : 3 * i + 3] = W[:, 3 * i : 3 * i + 3] = 0
        return W

    return matrix("fclib_local/W", change)


def add_guesses(count):
    return replaced("guesses/number_of_guesses", int32(count))


def add_constraint(G):
    def add(file):
        put_matrix(file, "fclib_global/G", G)
        file["fclib_global/vectors/b"] = np.zeros(1)

    return add


def linked(link):
    def replace(file):
        del file["fclib_local/vectors/q"]
        file["fclib_local/vectors/q"] = link

    return replace


def elsewhere(name):
    def move_out(file):
        replaced(name, None)(file)
        file.create_dataset(name, (12,), "f8", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])

    return move_out


def in_chunks(name, chunks):
    def store(file):
        replaced(name, None)(file)
        file.create_dataset(name, (12,), "f8", maxshape=(None,), chunks=chunks, compression="gzip")

    return store


def unequal_constraints(file):
    put_matrix(file, "fclib_local/V", np.ones((12, 2)))
    put_matrix(file, "fclib_local/R", np.zeros((0, 0)))
    file["fclib_local/vectors/s"] = np.zeros(2)


LOCAL, GLOBAL = "fclib_local", "fclib_global"
FAULTS = [
    (LOCAL, replaced("fclib_local", None), "neither fclib_local nor fclib_global"),
    (LOCAL, replaced("fclib_local", 1.0), "fclib_local is not a group"),
    (LOCAL, replaced("fclib_local/spacedim", None), "fclib_local/spacedim is missing"),
    (LOCAL, replaced("fclib_local/spacedim", int32(2)), "spacedim is 2"),
    (LOCAL, replaced("fclib_local/spacedim", int32(3, 3)), r"must be one integer: its shape is \(2,\)"),
    (LOCAL, replaced("fclib_local/spacedim", 3.0), "holds float64, not integers"),
    (LOCAL, replaced("fclib_local/W", None), "fclib_local/W is missing"),
    (LOCAL, replaced("fclib_local/W/x", None), "fclib_local/W/x is missing"),
    (LOCAL, replaced("fclib_local/W/nz", int32(-3)), "nz is -3"),
    (LOCAL, replaced("fclib_local/W/nzmax", int32(5)), "nzmax is 5"),
    (LOCAL, replaced("fclib_local/W/m", int32(-3)), "negative size"),
    (LOCAL, replaced("fclib_local/W/m", int32(15)), "mu has 4 values, not 5"),
    (LOCAL, replaced("fclib_local/W/m", int32(13)), "13 of W is not a multiple of 3"),
    (LOCAL, replaced("fclib_local/W/m", int32(0)), "no contacts"),
    (LOCAL, replaced("fclib_local/W/n", int32(15)), "W is 12 × 15, not 12 × 12"),
    (LOCAL, entry("fclib_local/W/p", 0, 1), "p does not rise"),
    (LOCAL, entry("fclib_local/W/p", 3, 100000), "p does not rise"),
    (LOCAL, entry("fclib_local/W/p", -1, 100000), "last value of p is 100000"),
    (LOCAL, replaced("fclib_local/W/p", int32(0, 1)), "p has 2 values, not 13"),
    (LOCAL, entry("fclib_local/W/i", 5, 12), "holds 12 at 5, out of range 0 to 11"),
    (LOCAL, entry("fclib_local/W/i", 5, -1), "holds -1 at 5"),
    (LOCAL, entry("fclib_local/W/x", 7, np.nan), "fclib_local/W/x is not finite .* at value 7"),
    (LOCAL, replaced("fclib_local/W/x", int32(1, 2)), "holds int32, not floating"),
    (LOCAL, replaced("fclib_local/W/x", np.zeros((3, 3))), "one-dimensional"),
    (LOCAL, lambda file: put_matrix(file, "fclib_local/W", np.triu(np.ones((12, 12)))), "W is not symmetric"),
    (LOCAL, lambda file: put_matrix(file, "fclib_local/W", -np.eye(12)), "no positive trace"),
    (LOCAL, without_contact(2), "diagonal block of W at contact 2|no diagonal block at contact 2"),
    (LOCAL, replaced("fclib_local/vectors", None), "fclib_local/vectors is missing"),
    (LOCAL, replaced("fclib_local/vectors/q", np.zeros(11)), "q has 11 values, not 12"),
    (LOCAL, entry("fclib_local/vectors/q", 4, np.inf), "q is not finite .* at value 4"),
    (LOCAL, entry("fclib_local/vectors/mu", 1, -0.5), "mu is negative .* at contact 1"),
    (LOCAL, entry("fclib_local/vectors/mu", 1, np.nan), "mu is not finite"),
    (LOCAL, lambda file: put_matrix(file, "fclib_local/R", np.eye(2)), "V and R"),
    (LOCAL, replaced("fclib_local/info/title", 5), "title holds int64, not text"),
    (LOCAL, replaced("fclib_local/info/title", ["a", "b"]), "title is not one text"),
    (LOCAL, replaced("solution/r", np.zeros(3)), "solution/r has 3 values, not 12"),
    (LOCAL, replaced("solution/u", np.full(12, np.nan)), "solution/u is not finite"),
    (LOCAL, replaced("solution", 1.0), "solution is not a group"),
    (LOCAL, replaced("guesses/1/r", np.zeros(12)), "guesses/number_of_guesses is missing"),
    (LOCAL, add_guesses(2), "guesses/1 is missing"),
    (LOCAL, add_guesses(-1), "number_of_guesses is -1"),
    (LOCAL, add_guesses(2**31 - 1), "number_of_guesses is 2147483647: more cannot be"),
    (LOCAL, replaced("fclib_local/vectors/s", np.zeros(2)), "V and R, and vectors/s"),
    (LOCAL, linked(h5py.SoftLink("/fclib_local/vectors/q")), "vectors/q is a link"),
    (LOCAL, linked(h5py.ExternalLink("other.hdf5", "/q")), "vectors/q is a link"),
    (LOCAL, elsewhere("fclib_local/vectors/q"), "vectors/q is stored in another file"),
    (LOCAL, in_chunks("fclib_local/vectors/q", (2**28,)), "vectors/q has an impossible size"),
    (LOCAL, unequal_constraints, r"R is 0 × 0, not 2 × 2|s has 0 values"),
    (LOCAL, entry("fclib_local/vectors/q", 4, 1e200), r"b, up to 1e\+200 m/s, cannot be squared"),
    (LOCAL, entry("fclib_local/vectors/q", slice(None), 1e-200), "b, up to 1e-200 m/s, cannot be squared"),
    (LOCAL, matrix("fclib_local/W", lambda file: 1e308 * np.eye(12)), "no positive trace that is finite"),
    (GLOBAL, replaced("fclib_global/vectors/b", np.zeros(2)), "G is missing"),
    (GLOBAL, replaced("fclib_global/H", None), "fclib_global/H is missing"),
    (GLOBAL, replaced("fclib_global/M/n", int32(14)), "M is 15 × 14, not 15 × 15"),
    (GLOBAL, replaced("fclib_global/vectors/f", None), "vectors/f is missing"),
    (GLOBAL, replaced("fclib_global/vectors/w", np.zeros(3)), "w has 3 values, not 12"),
    (
        GLOBAL,
        lambda file: put_matrix(file, "fclib_global/M", -np.eye(15)),
        "M is not positive definite: rod 0",
    ),
    (GLOBAL, lambda file: put_matrix(file, "fclib_global/M", np.tri(15)), "M is not symmetric"),
    (
        GLOBAL,
        lambda file: put_matrix(file, "fclib_global/H", np.eye(15, 12) * np.repeat([1, 0, 1, 1], 3)),
        "contact 1 moves no degree of freedom",
    ),
    (GLOBAL, lambda file: put_matrix(file, "fclib_global/G", np.ones((15, 1))), "vectors/b is missing"),
    (GLOBAL, add_constraint(np.ones((14, 1))), "G is 14 × 1, not 15 × 1"),
    (GLOBAL, add_constraint(np.zeros((15, 1))), "G is rank deficient"),
]


@pytest.mark.parametrize(("kind", "spoil", "fault"), FAULTS, ids=[fault for _, _, fault in FAULTS])
def test_a_faulty_file_is_refused_by_path_and_fault(tmp_path, kind, spoil, fault):
    step, path = make_step(), tmp_path / "a.hdf5"
    fclib.write(path, step if kind == GLOBAL else step.condense(), title="t")
    with h5py.File(path, "r+") as file:
        spoil(file)
    with pytest.raises(ProblemError, match=fault) as refusal:
        fclib.read(path)
    assert str(refusal.value).startswith(f"{path}: ")


def test_what_is_no_hdf5_file_is_refused(tmp_path):
    (tmp_path / "text").write_text("W = 1\n")
    (tmp_path / "empty").touch()
    for name, fault in {
        "absent": "no such file",
        "": "is a directory",
        "text": "not a readable HDF5 file",
        "empty": "not a readable HDF5 file",
    }.items():
        with pytest.raises(ProblemError, match=fault):
            fclib.read(tmp_path / name)


def test_an_absurd_size_is_refused_before_it_is_allocated(tmp_path):
    path = tmp_path / "a.hdf5"
    fclib.write(path, make_step())
    with h5py.File(path, "r+") as file:
        del file["fclib_global/vectors/w"]
        file.create_dataset("fclib_global/vectors/w", shape=(10**12,), chunks=(1000,), dtype=float)
    with pytest.raises(ProblemError, match="vectors/w has an impossible size"):
        fclib.read(path)


def test_a_damaged_value_is_caught_by_its_checksum(tmp_path):
    path = tmp_path / "a.hdf5"
    fclib.write(path, make_step())
    with h5py.File(path) as file:
        start = file["fclib_global/H/x"].id.get_chunk_info(0).byte_offset
    image = bytearray(path.read_bytes())
    image[start + 100] ^= 1
    path.write_bytes(image)
    with pytest.raises(ProblemError, match="fclib_global/H/x cannot be read"):
        fclib.read(path)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Bytes of valid files: ours, and uncompressed ones in the older layout that other codes write."""
    folder, step = tmp_path_factory.mktemp("images"), make_step()
    files = []
    for problem in (step, step.condense()):
        path = folder / f"{len(files)}.hdf5"
        solution = random_solution(problem, 0)
        fclib.write(path, problem, title="t", guesses=[solution], solution=solution)
        older = path.with_suffix(".old")
        with h5py.File(path) as source, h5py.File(older, "w") as target:
            source.visititems(lambda name, item, to=target: copy_plain(name, item, to))
        assert fclib.read(older).problem.n == problem.n
        files += [path.read_bytes(), older.read_bytes()]
    return folder, files


def copy_plain(name, item, target):
    if isinstance(item, h5py.Dataset):
        target[name] = item[()]


damage = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8)


@settings(deadline=None, max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 3), damage=damage, keep=st.one_of(st.just(1.0), st.floats(0, 1)))
def test_damaged_bytes_give_a_problem_or_one_clear_error(images, which, damage, keep):
    folder, files = images
    image = bytearray(files[which])
    for place, value in damage:
        image[int(place * len(image))] = value
    path = folder / "damaged.hdf5"
    path.write_bytes(image[: int(keep * len(image))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        try:
            file = fclib.read(path)
        except ProblemError as refusal:
            assert str(refusal).startswith(f"{path}: ")  # noqa: PT017 (either outcome is right)
        else:
            assert file.problem.n == 4


# Other people's files


@pytest.mark.parametrize("path", SHARED_FILES, ids=lambda path: path.stem)
def test_real_files_load_with_their_contacts_and_warnings(path, tmp_path):
    contacts, asymmetry = SHARED[path.stem]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        file = fclib.read(path)
    assert file.problem.n == contacts
    messages = [str(warning.message) for warning in caught if warning.category is ProblemWarning]
    assert messages == (
        [f"{path}: W is asymmetric by {asymmetry} (relative), replaced by its symmetric part"]
        if asymmetry
        else []
    )
    copy = tmp_path / "copy.hdf5"
    fclib.write(copy, file.problem, title=file.title, guesses=file.guesses, solution=file.solution)
    again = fclib.read(copy)
    condensed = [p.condense() if isinstance(p, StepProblem) else p for p in (file.problem, again.problem)]
    assert condensed[0].content_hash() == condensed[1].content_hash()
    assert again.title == file.title
