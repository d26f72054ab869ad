"""A set of problems: a folder of FCLIB files, with a manifest or without."""

import csv
import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fibercontact.bench.protocol import BenchError
from fibercontact.problem.constrained import ConstrainedStep
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem
from fibercontact.reference.existence import UNSOLVABLE
from fibercontact.reference.store import Store, references_file

__all__ = [
    "Entry", "content_hash", "entry_of", "find_file", "find_problem", "find_set", "known_sets", "limited", "load_set",
    "origin", "problem_files",
]  # fmt: skip

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
    for folder in (Path(name), *(shelf / name for shelf in _shelves())):
        if folder.is_dir():
            return folder
    known = ", ".join(sorted({folder.name for folder in known_sets()}))
    raise BenchError(f"no set of problems {name!r}: not a folder (known sets: {known or 'none'})")


def find_file(name: str) -> Path:
    """A file by its path, or by its name in `problems/` of the checkout or of the current folder."""
    for path in (Path(name), *(shelf / name for shelf in _shelves())):
        if path.is_file():
            return path
    raise BenchError(f"no such file: {name!r}, nor in problems/")


def known_sets() -> list[Path]:
    """Folders of the sets that have a name."""
    return [folder for shelf in _shelves() for folder in sorted(shelf.iterdir()) if folder.is_dir()]


def _shelves() -> list[Path]:
    """Folders of sets that are there: of the checkout, of the current folder, of the package."""
    package = Path(__file__).parents[1]
    shelves = package.parent / "problems", Path("problems"), package / "data"
    return [shelf for shelf in shelves if shelf.is_dir()]


def load_set(folder: Path) -> list[Entry]:
    """The problems of a folder, in the manifest's order or by file name.

    Those proved unsolvable by `fibercontact reference`, whose certificate is checked here, are marked as such. Raises
    `BenchError` when there is none or one is there twice, when a file of the manifest is missing, or when its
    content is not the one whose hash the manifest holds.
    """
    manifest = folder / MANIFEST
    entries = _listed(manifest) if manifest.is_file() else [entry_of(file) for file in problem_files(folder)]
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


def find_problem(name: str) -> Entry:
    """A problem by its file, or by its name in a known set; raises `BenchError` naming sets and nearest names."""
    if Path(name).is_file():
        return entry_of(Path(name))
    sets = known_sets()
    files = {file.stem: file for folder in reversed(sets) for file in problem_files(folder)}
    if name in files:
        return entry_of(files[name])
    near = difflib.get_close_matches(name, files, n=3, cutoff=0.0)
    looked = f"nor in {', '.join(map(str, sets))} (nearest: {', '.join(near) or 'none'})"
    raise BenchError(f"no problem {name!r}: no file, {looked if sets else 'and no set of problems is here'}")


def problem_files(folder: Path) -> list[Path]:
    """The FCLIB files in a folder, by name."""
    return sorted(file for file in folder.iterdir() if file.suffix in SUFFIXES)


def origin(entry: Entry) -> tuple[str, int]:
    """The scene and the step that a problem is from, by the manifest beside it; raises `BenchError` without one."""
    manifest = entry.file.parent / MANIFEST
    for line in _lines(manifest) if manifest.is_file() else ():
        if line.get("file") == entry.file.name and line.get("scene") and (line.get("step") or "").isdigit():
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


def _listed(manifest: Path) -> list[Entry]:
    return [_entry(manifest, number, line) for number, line in enumerate(_lines(manifest), start=2)]


def _lines(manifest: Path) -> list[dict[str, str]]:
    try:
        with manifest.open(newline="", encoding="utf-8") as stream:
            return list(csv.DictReader(stream))
    except (ValueError, csv.Error) as fault:  # of its bytes, of its fields
        raise BenchError(f"{manifest}: not readable ({fault})") from None


def _entry(manifest: Path, number: int, line: dict[str, str]) -> Entry:
    if not line.get("file"):
        raise BenchError(f"{manifest}: no file named in line {number}")
    file = manifest.parent / line["file"]
    if not file.is_file():
        raise BenchError(f"{manifest}: {line['file']} is listed but not there")
    found, expected = _sha256(file), line.get("hash") or ""
    if not found.startswith(expected) and not content_hash(read(file).problem).startswith(expected):
        raise BenchError(
            f"{file}: its content is not the one that the manifest lists (hash {expected[:16]}…)"
        )
    scene = line.get("scene") or manifest.parent.resolve().name
    return Entry(file, scene, found[:HASH_DIGITS], line.get("existence") or "")


def _sha256(file: Path) -> str:
    if file.exists() and not file.is_file():  # a pipe would be waited for, a device has no end
        raise BenchError(f"{file}: is not a file on a disk")
    return hashlib.sha256(file.read_bytes()).hexdigest()


def content_hash(problem: IncrementalProblem | StepProblem | ConstrainedStep) -> str:
    """Hash of the incremental problem, whatever it is posed as."""
    return (problem if isinstance(problem, IncrementalProblem) else problem.condense()).content_hash()
