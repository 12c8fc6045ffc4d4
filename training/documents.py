"""Results as Markdown: tables, documents, and the generated blocks of a document."""

from collections.abc import Sequence
from pathlib import Path

from arm_blender.errors import OutputError
from arm_blender.machine.files import whole_file

Row = tuple[str, str, str]
"""Of a table of extreme inputs: case, what is measured, result."""


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table. Columns of numbers are aligned to the right; floats get three decimals."""
    cells = [[_cell(value) for value in row] for row in rows]
    numeric = [all(row[i].lstrip("-")[:1].isdecimal() or row[i] == "-" for row in cells) for i in range(len(header))]
    lines = [header, ["---:" if right else "---" for right in numeric], *cells]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3f}"
    return f"{value:,}" if isinstance(value, int) else str(value).replace("|", "\\|")


def paragraphs(*parts: str) -> str:
    """The parts of a Markdown document, each a paragraph, heading or table of its own."""
    return "\n\n".join(parts)


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all, making its folder.

    Raises:
        OutputError: the place cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path.parent}: cannot be made ({error.strerror}); choose another place") from error
    with whole_file(path) as temporary:
        temporary.write_text(text.strip() + "\n", encoding="utf-8")


def fill_block(path: Path, name: str, text: str) -> None:
    """Replace what stands between `<!-- name:begin -->` and `<!-- name:end -->` in a document.

    Raises:
        OutputError: the document has no such block, or cannot be written.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    document = path.read_text(encoding="utf-8") if path.exists() else ""
    head, found_begin, rest = document.partition(begin)
    _, found_end, tail = rest.partition(end)
    if not (found_begin and found_end):
        raise OutputError(f"{path}: has no block {begin} ... {end} to fill; add both lines")
    write_text(path, f"{head}{begin}\n{text.strip()}\n{end}{tail}")
