"""Put the sample set into wheel and sdist: its problems are files of core306, which a checkout holds once."""

import csv
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

PROBLEMS = Path(__file__).parent / "problems"


def gather(shelf: Path) -> None:
    """Copy the problems that the sample's manifest lists, the manifest, and the references, to `shelf`."""
    with (PROBLEMS / "sample" / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    folder = shelf / "sample"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "manifest.csv").open("w", newline="", encoding="utf-8") as stream:
        manifest = csv.DictWriter(stream, lines[0])
        manifest.writeheader()
        for line in lines:
            file = PROBLEMS / "sample" / line["file"]
            shutil.copyfile(file, folder / file.name)
            manifest.writerow(line | {"file": file.name})
    shutil.copyfile(PROBLEMS / "sample.references.hdf5", shelf / "sample.references.hdf5")


class BuildWithSample(build_py):
    """A wheel carries the sample in `fibercontact/data`; an editable installation finds it in `problems/`."""

    def run(self) -> None:
        """Build, then gather."""
        super().run()
        if not self.editable_mode:
            gather(Path(self.build_lib, "fibercontact", "data"))


class SdistWithSample(sdist):
    """An sdist carries the sample in `problems/`, as files."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Make the tree, then gather."""
        super().make_release_tree(base_dir, files)
        gather(Path(base_dir, "problems"))


setup(cmdclass={"build_py": BuildWithSample, "sdist": SdistWithSample})
