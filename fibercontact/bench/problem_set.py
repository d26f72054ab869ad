"""A set of problems: a folder of FCLIB files, with a manifest or without."""

import csv
import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fibercontact.bench.protocol import BenchError
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference.existence import UNSOLVABLE
from fibercontact.reference.store import Store, references_file

__all__ = ["Entry", "entry_of", "find_file", "find_problem", "find_set", "limited", "load_set", "origin"]

MANIFEST = "manifest.csv"
SUFFIXES = (".hdf5", ".h5")
HASH_DIGITS = 16


@dataclass(frozen=True)
class Entry:
    """A problem of a set: file, scene, start of the file's SHA-256, what is known of existence."""

    file: Path
    scene: str
    hash: str
    existence: str = ""

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self.file.stem


def find_set(name: str) -> Path:
    """Folder of a set: a path, or a name: in `problems/` of the checkout or the current folder, or in the package."""
    candidates = _candidates(name)
    for folder in candidates:
        if folder.is_dir():
            return folder
    shelves = {candidate.parent for candidate in candidates[1:] if candidate.parent.is_dir()}
    known = sorted({folder.name for shelf in shelves for folder in shelf.iterdir() if folder.is_dir()})
    raise BenchError(f"no set of problems {name!r}: not a folder (known sets: {', '.join(known) or 'none'})")


def find_file(name: str) -> Path:
    """A file by its path, or by its name in `problems/` of the checkout or of the current folder."""
    for path in _candidates(name):
        if path.is_file():
            return path
    raise BenchError(f"no such file: {name!r}, nor in problems/")


def _candidates(name: str) -> list[Path]:
    """Where a name of the user's may be."""
    package = Path(__file__).parents[1]
    shelves = package.parent / "problems", Path("problems"), package / "data"
    return [Path(name), *(shelf / name for shelf in shelves)]


def load_set(folder: Path) -> list[Entry]:
    """The problems of a folder, in the manifest's order or by file name.

    Those proved unsolvable by `fibercontact reference`, whose certificate is checked here, are marked as such. Raises
    `BenchError` when there is none or one is there twice, when a file of the manifest is missing, or when its
    content is not the one whose hash the manifest holds.
    """
    manifest = folder / MANIFEST
    entries = _listed(manifest) if manifest.is_file() else _found(folder)
    if not entries:
        raise BenchError(f"{folder}: no FCLIB files ({', '.join('*' + s for s in SUFFIXES)}) in it")
    seen: dict[str, Entry] = {}
    for entry in entries:
        if (other := seen.setdefault(entry.hash, entry)) is not entry:
            raise BenchError(f"{folder}: {other.file.name} and {entry.file.name} are the same problem")
    store = Store(references_file(folder))
    claimed = store.claimed_unsolvable()
    return [_proved(entry, store) if entry.hash in claimed else entry for entry in entries]


def entry_of(file: Path) -> Entry:
    """The problem in a file, its folder taken for its scene."""
    return Entry(file, file.parent.resolve().name, _sha256(file)[:HASH_DIGITS])


def find_problem(name: str, problems: str = "core306") -> Entry:
    """A problem by its file, or by its name in a set; raises `BenchError` naming the nearest names."""
    if Path(name).is_file():
        return entry_of(Path(name))
    folder = find_set(problems)
    files = {file.stem: file for file in sorted(folder.iterdir()) if file.suffix in SUFFIXES}
    if name in files:
        return entry_of(files[name])
    near = difflib.get_close_matches(name, files, n=3, cutoff=0.0)
    raise BenchError(
        f"no problem {name!r}: neither a file nor one of the {len(files)} of {folder.name} "
        f"(nearest: {', '.join(near)})"
    )


def origin(entry: Entry) -> tuple[str, int]:
    """The scene and the step that a problem is from, by the manifest beside it; raises `BenchError` without one."""
    manifest = entry.file.parent / MANIFEST
    if manifest.is_file():
        with manifest.open(newline="", encoding="utf-8") as stream:
            for line in csv.DictReader(stream):
                if (
                    line.get("file") == entry.file.name
                    and line.get("scene")
                    and (line.get("step") or "").isdigit()
                ):
                    return line["scene"], int(line["step"])
    raise BenchError(f"{entry.file}: no {MANIFEST} beside it tells the scene and the step it is from")


def limited(entries: Sequence[Entry], limit: int | None) -> list[Entry]:
    """`limit` problems spread evenly over a set, for trials; all of them by default."""
    if limit is None or limit >= len(entries):
        return list(entries)
    return [entries[k * len(entries) // limit] for k in range(limit)]


def _proved(entry: Entry, store: Store) -> Entry:
    """The entry, marked as unsolvable if the stored certificate holds."""
    return (
        replace(entry, existence=UNSOLVABLE)
        if store.unsolvable(entry.hash, read(entry.file).problem)
        else entry
    )


def _found(folder: Path) -> list[Entry]:
    files = sorted(file for file in folder.iterdir() if file.suffix in SUFFIXES)
    return [entry_of(file) for file in files]


def _listed(manifest: Path) -> list[Entry]:
    with manifest.open(newline="", encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    return [_entry(manifest, number, line) for number, line in enumerate(lines, start=2)]


def _entry(manifest: Path, number: int, line: dict[str, str]) -> Entry:
    if not line.get("file"):
        raise BenchError(f"{manifest}: no file named in line {number}")
    file = manifest.parent / line["file"]
    if not file.is_file():
        raise BenchError(f"{manifest}: {line['file']} is listed but not there")
    found, expected = _sha256(file), line.get("hash")
    if expected and expected != found[: len(expected)] and expected != _content_hash(file)[: len(expected)]:
        raise BenchError(
            f"{file}: its content is not the one that the manifest lists (hash {expected[:16]}…)"
        )
    scene = line.get("scene") or manifest.parent.resolve().name
    return Entry(file, scene, found[:HASH_DIGITS], line.get("existence") or "")


def _sha256(file: Path) -> str:
    if file.exists() and not file.is_file():  # a pipe would be waited for, a device has no end
        raise BenchError(f"{file}: is not a file on a disk")
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _content_hash(file: Path) -> str:
    """Hash of the incremental problem in a file: for manifests that name the problem, not the file."""
    problem = read(file).problem
    return (problem if isinstance(problem, IncrementalProblem) else problem.condense()).content_hash()
