"""Damage to FCLIB files: each mutation is a small function of a random generator, one way for a file to be wrong.

`mutant` puts one damaged file at a path: the same number gives the same damage. `seed_files` makes the sound files
that are damaged: both kinds, with and without bilateral constraints, as this project stores them and as FCLIB does.
"""

import gzip
import os
import shutil
import zlib
from pathlib import Path

import h5py
import numpy as np
from oracles import strands
from scipy.sparse import csc_array

from fibercontact.problem.fclib import Solution, write

# Sound files


def seed_files(folder, more=()):
    """Small sound files in a new folder, and copies of the files `more`; their paths in order."""
    folder.mkdir()
    step = strands(1, rods=3, dofs=6, contacts=4)
    answer = Solution(u=np.ones(12), r=np.arange(12.0))
    texts = {"title": "a hair", "description": "Örtliche Reibung", "math_info": "super-helix"}
    write(folder / "global.hdf5", step, guesses=[answer], solution=Solution(v=np.zeros(18)), **texts)
    write(folder / "local.hdf5", step.condense(), guesses=[answer, answer], solution=answer, **texts)
    constrained(folder, step, np.random.default_rng(2).standard_normal((18, 2)))
    for file in sorted(folder.iterdir()):
        as_fclib_stores(file, file.with_name(f"{file.stem}-plain.hdf5"))
    for file in more:
        shutil.copyfile(file, folder / file.name)
    return sorted(folder.iterdir())


def constrained(folder, step, G):
    """Write the step with constraints `Gᵀ v = 0`, and its condensation with their multipliers."""
    shutil.copyfile(folder / "global.hdf5", folder / "global-bilateral.hdf5")
    with h5py.File(folder / "global-bilateral.hdf5", "r+") as file:
        put_matrix(file["fclib_global"], "G", G)
        file["fclib_global/vectors/b"] = np.zeros(2)
    shutil.copyfile(folder / "local.hdf5", folder / "local-bilateral.hdf5")
    response = np.linalg.solve(step.M.toarray(), G)
    with h5py.File(folder / "local-bilateral.hdf5", "r+") as file:
        put_matrix(file["fclib_local"], "V", step.H @ response)
        put_matrix(file["fclib_local"], "R", G.T @ response)
        file["fclib_local/vectors/s"] = np.zeros(2)


def put_matrix(parent, name, A):
    """Store a dense matrix by columns."""
    A, group = csc_array(A), parent.create_group(name)
    for key, value in {"m": A.shape[0], "n": A.shape[1], "nz": -1, "nzmax": A.nnz}.items():
        group[key] = np.array([value], dtype=np.int32)
    group["p"], group["i"], group["x"] = A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data


def as_fclib_stores(source, target):
    """Copy a file into HDF5's oldest format: no checksums, no compression, matrices as triplets."""
    with h5py.File(source) as old, h5py.File(target, "w", libver="earliest") as new:
        for name in names(old, h5py.Dataset):
            new[name] = old[name][()]
        for name in [name for name in names(new, h5py.Group) if "nz" in new[name]]:
            group = new[name]
            columns = np.repeat(np.arange(len(group["p"]) - 1), np.diff(group["p"][:]))
            group["nz"][:] = len(columns)
            del group["p"]
            group["p"] = columns.astype(np.int32)


def names(file, kind):
    """Paths of the members of a kind."""
    found = []
    file.visititems(lambda name, member: found.append(name) if isinstance(member, kind) else None)
    return found


# Members: (rng, file) with the file open


def any_member(rng, file):
    return rng.choice(names(file, h5py.HLObject))


def any_dataset(rng, file, kinds="iufcSO"):
    return rng.choice([name for name in names(file, h5py.Dataset) if file[name].dtype.kind in kinds])


def put(file, name, *shape, **how):
    """Put a dataset in the place of another."""
    del file[name]
    return file.create_dataset(name, *shape, **how)


def removed(rng, file):
    del file[any_member(rng, file)]


def renamed(rng, file):
    name = any_member(rng, file)
    file.move(name, f"{name}_")


def exchanged(rng, file):
    one, other = any_dataset(rng, file), any_dataset(rng, file)
    values = file[one][()], file[other][()]
    put(file, one, data=values[1])
    put(file, other, data=values[0])


def group_for_dataset(rng, file):
    name = any_dataset(rng, file)
    del file[name]
    file.create_group(name)


def dataset_for_group(rng, file):
    put(file, rng.choice(names(file, h5py.Group)), data=1.0)


def emptied_group(rng, file):
    file[rng.choice(names(file, h5py.Group))].clear()


NUMBERS = ["i1", "u1", "i2", ">i4", "i8", "u8", "f2", "f4", ">f8", "g", "c16", "?", "S8"]
TYPES = {name: lambda x, name=name: {"data": x.astype(name)} for name in NUMBERS} | {
    "string": lambda x: {"data": [str(v) for v in x], "dtype": h5py.string_dtype()},
    "text": lambda x: {"data": "seven"},
    "lists": lambda x: {"shape": x.shape, "dtype": h5py.vlen_dtype(np.float64)},
    "enum": lambda x: {"data": np.zeros(x.shape, h5py.enum_dtype({"YES": 0, "NO": 1}))},
    "opaque": lambda x: {"data": np.zeros(x.shape, "V8")},
    "pairs": lambda x: {"data": np.zeros(x.shape, [("a", "f8"), ("b", "i4")])},
    "rows": lambda x: {"shape": x.shape, "dtype": np.dtype(("f8", (3,)))},
    "reference": lambda x: {"shape": x.shape, "dtype": h5py.ref_dtype},
    "region": lambda x: {"shape": x.shape, "dtype": h5py.regionref_dtype},
    "nothing": lambda x: {"data": h5py.Empty("f8")},
}


def of_another_type(rng, file):
    name = any_dataset(rng, file, "iuf")
    with np.errstate(all="ignore"):
        put(file, name, **TYPES[rng.choice(list(TYPES))](np.atleast_1d(file[name][()])))


SHAPES = [
    lambda x: x[0] if len(x) else x,
    lambda x: x[:, None],
    lambda x: x[None],
    lambda x: x[:0],
    lambda x: x[:-1],
    lambda x: x[1:],
    lambda x: np.append(x, x[-1:]),
    lambda x: np.append(x, np.zeros(1000, x.dtype)),
    lambda x: np.tile(x, 2),
    lambda x: x.reshape([1] * 30 + [-1]),
]


def of_another_shape(rng, file):
    name = any_dataset(rng, file, "iuf")
    put(file, name, data=SHAPES[rng.integers(len(SHAPES))](np.atleast_1d(file[name][()])))


def huge(rng, file):
    """A size that nothing is stored of."""
    name = any_dataset(rng, file)
    size, dtype = int(rng.choice([10**6, 2**31, 2**33, 2**40, 2**60])), file[name].dtype
    shape = (size,) if rng.random() < 0.7 else (size // 1000, 1000)
    put(file, name, shape, dtype=dtype, chunks=tuple(min(length, 1000) for length in shape))


def huge_chunk(rng, file):
    """A few values, in a chunk that says to unpack to far more."""
    name = any_dataset(rng, file, "iuf")
    dataset = put(
        file, name, file[name].shape, dtype=file[name].dtype, maxshape=(None,), compression="gzip",
        chunks=(int(2 ** rng.integers(20, 29)),),
    )  # fmt: skip
    dataset.id.write_direct_chunk((0,), zlib.compress(bytes(1000)))


def bomb(rng, file):
    """Zeros, as many as gzip can hold in little."""
    name = any_dataset(rng, file, "iuf")
    size, dtype = int(10 ** rng.uniform(4, 6.5)), file[name].dtype
    put(file, name, data=np.zeros(size, dtype), chunks=(size,), compression="gzip", compression_opts=9)


def long_text(rng, file):
    """Very many references to one text."""
    name = any_dataset(rng, file, "SO")
    texts = put(file, name, (10**5,), dtype=h5py.string_dtype(), compression="gzip", chunks=(10**5,))
    texts[:] = "x" * 1000


EXTREMES = [-(2**31), -1000, -3, -2, -1, 0, 1, 2, 3, 12, 13, 15, 18, 10**6, 2**31 - 1, 2**40, 2**63 - 1]


def integers(rng, file):
    """Sizes and counts."""
    for _ in range(rng.integers(1, 4)):
        scalars = [name for name in names(file, h5py.Dataset) if file[name].size == 1]
        name = rng.choice([name for name in scalars if file[name].dtype.kind == "i"])
        value = (
            int(rng.choice(EXTREMES)) if rng.random() < 0.7 else int(file[name][0]) + int(rng.integers(-3, 4))
        )
        put(file, name, data=[value], dtype=np.int64 if value < 2**63 else np.uint64)


VALUES = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-320, 1e-160, 1e100, 1e160, -1e300, 1e308]


def values(rng, file):
    """Numbers."""
    name = any_dataset(rng, file, "f")
    x = file[name][()]
    x[rng.integers(len(x), size=rng.integers(1, 4))] = rng.choice(VALUES)
    put(file, name, data=x)


def all_values(rng, file):
    """All numbers of a vector on another scale."""
    name = any_dataset(rng, file, "f")
    put(file, name, data=file[name][()] * rng.choice([-1, 0, 1e-200, 1e-100, 1e100, 1e154, 1e200, 1e300]))


def indices(rng, file):
    """Places of a matrix."""
    name = rng.choice([name for name in names(file, h5py.Dataset) if name[-2:] in ("/p", "/i")])
    x = file[name][()]
    change = rng.integers(4)
    if change == 0:
        x[rng.integers(len(x))] = rng.choice([-1, -(2**31), 2**31 - 1, x.max() + 1, x.max(), 0])
    elif change == 1:
        rng.shuffle(x)
    elif change == 2:
        x = x[::-1]
    else:
        x[:] = x[rng.integers(len(x))]
    put(file, name, data=x)


def linked(rng, file):
    """A link in the place of a member: to nothing, round in a circle, out of the file."""
    name = any_member(rng, file)
    parent = name.rpartition("/")[0] or "/"
    targets = [
        *(h5py.SoftLink(path) for path in ("/nowhere", f"/{name}", "/", parent, f"/{any_member(rng, file)}")),
        *(file[path] for path in ("/", parent)),
        *(
            h5py.ExternalLink(path, f"/{name}")
            for path in ("nowhere.hdf5", file.filename, "/dev/zero", "fifo")
        ),
    ]
    target = targets[rng.integers(len(targets))]
    del file[name]
    file[name] = target


def linked_twice(rng, file):
    """One group under many names."""
    groups = file.require_group("guesses")
    groups.clear()
    groups["1/r"], groups["number_of_guesses"] = np.zeros(12), np.array([3000], np.int32)
    for k in range(2, 3001):
        groups[str(k)] = groups["1"]


def stored_elsewhere(rng, file):
    """Values in another file: a device, a pipe, a text."""
    name = any_dataset(rng, file, "iuf")
    where = rng.choice(["/dev/zero", "fifo", "/etc/hostname", "nowhere.bin"])
    old = file[name]
    put(file, name, old.shape, dtype=old.dtype, external=[(where, 0, h5py.h5f.UNLIMITED)])


def made_of_others(rng, file):
    """A virtual dataset: views of another file, or of itself."""
    name = any_dataset(rng, file, "iuf")
    old = file[name]
    view = h5py.VirtualLayout(old.shape, old.dtype)
    where = rng.choice([file.filename, "nowhere.hdf5", "fifo"])
    view[...] = h5py.VirtualSource(where, name, old.shape, old.dtype)
    del file[name]
    file.create_virtual_dataset(name, view)


def unknown_filter(rng, file):
    name = any_dataset(rng, file, "iuf")
    old = file[name]
    new = put(
        file, name, old.shape, dtype=old.dtype, chunks=old.shape, compression=32123, allow_unknown_filter=True
    )
    new.id.write_direct_chunk((0,), bytes(old.nbytes))


# Bytes: (rng, bytes) to bytes


def flipped(rng, data, count, end):
    data = bytearray(data)
    for at in rng.integers(min(end, len(data)), size=count):
        data[at] ^= 1 << rng.integers(8)
    return bytes(data)


def one_bit(rng, data):
    return flipped(rng, data, 1, len(data))


def a_few_bits(rng, data):
    return flipped(rng, data, rng.integers(2, 30), len(data))


def many_bits(rng, data):
    return flipped(rng, data, len(data) // 20, len(data))


def bits_of_the_head(rng, data):
    return flipped(rng, data, rng.integers(1, 4), 800)


def a_byte(rng, data):
    at = rng.integers(len(data))
    return data[:at] + bytes([rng.choice([0, 1, 127, 128, 255])]) + data[at + 1 :]


def a_number(rng, data):
    """Eight bytes in a row, where an address or a length may be."""
    at = 8 * rng.integers(len(data) // 8)
    numbers = [0, 1, len(data), len(data) - at, at, 2**31, 2**32 - 1, 2**62, 2**64 - 1]
    value = int(numbers[rng.integers(len(numbers))])
    return data[:at] + value.to_bytes(8, "little") + data[at + 8 :]


def truncated(rng, data):
    return data[: rng.integers(len(data))]


def extended(rng, data):
    return data + rng.bytes(rng.integers(1, 5000))


def blank(rng, data):
    start, end = sorted(rng.integers(len(data), size=2))
    return data[:start] + bytes(end - start) + data[end:]


def moved(rng, data):
    """A piece of the file written over another."""
    length = int(rng.integers(1, 600))
    source, target = rng.integers(len(data) - length, size=2)
    return data[:target] + data[source : source + length] + data[target + length :]


def shortened(rng, data):
    """A piece cut out."""
    at = rng.integers(len(data))
    return data[:at] + data[at + rng.integers(1, 100) :]


def behind_a_block(rng, data):
    """HDF5 allows for a block of the user's before it."""
    return bytes(int(rng.choice([512, 1024, 600]))) + data


def another_format(rng, data):
    others = [
        b"",
        b"\0",
        b"\x89HDF\r\n\x1a\n",
        b"<xml/>\n" * 100,
        gzip.compress(data),
        rng.bytes(4000),
        bytes(10**5),
    ]
    return others[rng.integers(len(others))]


# Places: (rng, path) with a sound file at the path


def directory(rng, path):
    path.unlink()
    path.mkdir()


def pipe(rng, path):
    path.unlink()
    os.mkfifo(path)


def device(rng, path):
    path.unlink()
    path.symlink_to(rng.choice(["/dev/zero", "/dev/null", "/dev/full"]))


def circle(rng, path):
    path.unlink()
    path.symlink_to(path)


def absent(rng, path):
    path.unlink()


MEMBERS = (
    removed, renamed, exchanged, group_for_dataset, dataset_for_group, emptied_group, of_another_type,
    of_another_shape, huge, huge_chunk, bomb, long_text, integers, integers, values, all_values, indices, indices,
    linked, linked, linked_twice, stored_elsewhere, made_of_others, unknown_filter,
)  # fmt: skip
BYTES = (
    one_bit, a_few_bits, many_bits, bits_of_the_head, a_byte, a_number, a_number, truncated, extended, blank, moved,
    shortened, behind_a_block, another_format,
)  # fmt: skip
PLACES = (directory, pipe, device, circle, absent)
MUTATIONS = MEMBERS + BYTES + MEMBERS + BYTES + PLACES


def mutant(number, seeds, path):
    """Put the damaged file of that number at the path, in a folder with a pipe; returns what was done to it."""
    rng = np.random.default_rng(number)
    mutation, seed = MUTATIONS[number % len(MUTATIONS)], Path(rng.choice(seeds))
    shutil.copyfile(seed, path)
    if mutation in PLACES:
        mutation(rng, path)
    elif mutation in BYTES:
        path.write_bytes(mutation(rng, path.read_bytes()))
    else:
        with h5py.File(path, "r+", libver=("earliest", "v110")) as file:
            mutation(rng, file)
    return f"{mutation.__name__} of {seed.name}"
