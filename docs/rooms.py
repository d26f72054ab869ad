"""Sphinx extension: a page for each room of the package, from the docstrings of its modules; one for the commands.

Pages that the index does not list are put into its last section.

Docstrings are plain prose with `code` in single backticks and displayed lines indented by four spaces; here they
become reStructuredText, and `THEORY §3` a link.
"""

import re
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import fibercontact

PACKAGE = Path(fibercontact.__file__).parent
ROOMS = (
    "rods", "contact", "problem", "local", "gauss_seidel", "global_methods", "peers",
    "simulation", "reference", "bench",
)  # fmt: skip
ELSEWHERE = "children"  # modules that run in other people's Python
SHORT = {
    r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.(\w+)\]\]": r"NDArray[\1]",
    r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]": r"NDArray[\1]",
    r"tuple\[float, float, float\]": "Vector",
    r"tuple\[Vector, Vector, Vector\]": "Matrix",
}
"""Types whose written-out names hide the signature."""


def setup(app: Any) -> dict[str, bool]:
    """Write the pages, and have autodoc ask us about docstrings, signatures and members."""
    app.connect("config-inited", lambda app, _: write_pages(Path(app.srcdir, "api")))
    app.connect("source-read", lambda _, name, source: _list_the_rest(source) if name == "index" else None)
    app.connect("autodoc-process-docstring", lambda *event: _replace(event[-1]))
    app.connect("autodoc-process-signature", lambda *event: (_shortened(event[-2]), _shortened(event[-1])))
    app.connect("autodoc-skip-member", lambda *event: _is_field(event[3]) or None)
    return {"parallel_read_safe": True}


def write_pages(folder: Path) -> None:
    """One page a room, its modules in alphabetical order; what belongs to no room; the commands."""
    folder.mkdir(exist_ok=True)
    for room in ROOMS:
        _write(
            folder / f"{room}.rst",
            "\n".join(_page(room, f"fibercontact.{room}", (PACKAGE / room).rglob("*.py"))),
        )
    _write(folder / "shared.rst", "\n".join(_page("shared", "fibercontact", PACKAGE.glob("*.py"))))
    _write(folder / "commands.md", commands())


def _list_the_rest(source: list[str]) -> None:
    """Add the pages that no list of the index names."""
    listed = {"index", *re.findall(r"^(\w+)$", source[0], flags=re.MULTILINE)}
    rest = sorted(file.stem for file in Path(__file__).parent.glob("*.md") if file.stem not in listed)
    if rest:
        source[0] += "\n".join(["", "```{toctree}", ":caption: More", ":hidden:", "", *rest, "```", ""])


def _write(file: Path, text: str) -> None:
    """Write what has changed, so that the rest need not be read again."""
    if not file.is_file() or file.read_text(encoding="utf-8") != text:
        file.write_text(text, encoding="utf-8")


def _page(title: str, package: str, files: Iterable[Path]) -> Iterator[str]:
    yield from (*_section(title, "="), f".. automodule:: {package}", "   :no-members:", "")
    for file in sorted(files):
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        if ELSEWHERE not in parts and not file.name.startswith("__"):
            yield from (
                *_section(".".join(parts), "-"),
                f".. automodule:: fibercontact.{'.'.join(parts)}",
                "",
            )


def _section(title: str, line: str) -> tuple[str, ...]:
    escaped = title.replace("_", r"\_")
    return (escaped, line * len(escaped), "")


def commands() -> str:
    """The help of every command, as Markdown."""
    from typer.cli import get_docs_for_click
    from typer.main import get_command

    from fibercontact.cli import app

    command = get_command(app)
    context = command.make_context("fibercontact", [], resilient_parsing=True)
    text = get_docs_for_click(obj=command, ctx=context, title="Commands")
    shown = re.sub(r"^Example: (fibercontact .+)$", r"For example:\n\n\1", text, flags=re.MULTILINE)
    displayed = re.sub(r"^(fibercontact .+)$", r"    \1", shown, flags=re.MULTILINE)
    return re.sub(r"^(    .+)\n\n(?=    )", r"\1\n", displayed, flags=re.MULTILINE)


def _replace(lines: list[str]) -> None:
    lines[:] = restructured(lines)


def _shortened(signature: str | None) -> str | None:
    for long, short in SHORT.items():
        signature = re.sub(long, short, signature) if signature else signature
    return signature


def _is_field(member: Any) -> bool:
    """A field of a named tuple, of which Python says no more than its number."""
    return str(getattr(member, "__doc__", "")).startswith("Alias for field number")


def restructured(lines: list[str]) -> list[str]:
    """A docstring in reStructuredText: displayed lines become literal blocks, backticks code, the rest is prose."""
    found: list[str] = []
    for displayed, group in groupby(_marked(lines), key=lambda line: line[0]):
        block = [text for _, text in group]
        found += ["", "::", "", *block, ""] if displayed else _prose("\n".join(block)).split("\n")
    return found


def _marked(lines: list[str]) -> list[tuple[bool, str]]:
    """Each line, and whether it is displayed; an empty one goes with the line before it."""
    marked: list[tuple[bool, str]] = []
    for line in lines:
        displayed = line.startswith("    ") if line.strip() else bool(marked) and marked[-1][0]
        marked.append((displayed, line))
    return marked


def _prose(text: str) -> str:
    """Prose with its code; examples with `>>>` are left as they are."""
    parts = re.split(r"(^>>> (?:.+\n?)+|`[^`]+`)", text, flags=re.MULTILINE)
    return "".join(part if part.startswith(">>> ") else _piece(part) for part in parts)


def _piece(text: str) -> str:
    if text.startswith("`"):
        return rf"\ ``{text.strip('`')}``\ "
    bullets = re.sub(r"^\* ", "\0 ", text, flags=re.MULTILINE)
    emphases = re.sub(r"(?<!\w)\*(\w[^*\n]*\w)\*(?!\w)", "\1\\1\1", bullets)
    escaped = re.sub(r"([\\*|_])", r"\\\1", emphases)
    linked = re.sub(r"THEORY §(\d)", r":ref:`THEORY §\1 <theory-\1>`", escaped)
    return linked.replace("\0", "*").replace("\1", "*")
