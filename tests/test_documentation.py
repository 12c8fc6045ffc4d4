"""The documents: every link leads somewhere, every command line is understood, every quoted message is in the code."""

import ast
import contextlib
import io
import re
import shlex
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from arm_blender.__main__ import parser as arm_parser
from training.__main__ import understood

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "arm_blender" / "weights" / "README.md"])
FENCED = re.compile(r"^```(?:sh|python)? ?\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
INLINE = re.compile(r"`([^`]+)`")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.fixture(params=PAGES, ids=name_of)
def page(request) -> Path:
    return request.param


@cache
def anchors(path: Path) -> frozenset[str]:
    """Of the headings, as GitHub makes them."""
    text = FENCED.sub("", path.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings)


def links(text: str) -> list[str]:
    return LINK.findall(INLINE.sub("", FENCED.sub("", text)))


def test_every_link_leads_to_a_file_and_a_heading(page):
    for target in links(page.read_text(encoding="utf-8")):
        if target.startswith(("https://", "mailto:")):
            continue
        assert not target.startswith("/"), target
        place, _, anchor = target.partition("#")
        path = (page.parent / place).resolve() if place else page
        assert path.exists() and path.is_relative_to(ROOT), f"{name_of(page)}: {target}"
        assert not anchor or anchor in anchors(path), f"{name_of(page)}: {target}; there are {sorted(anchors(path))}"


def test_every_page_is_reached_from_the_front():
    reached, ahead = set(), [ROOT / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in reached:
            continue
        reached.add(page)
        local = [target.partition("#")[0] for target in links(page.read_text(encoding="utf-8"))]
        ahead += [(page.parent / target).resolve() for target in local if target.endswith(".md") and ":" not in target]
    assert {page for page in PAGES if page.parent.name == "docs"} <= reached


def test_the_front_page_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 900


def command_lines(text: str) -> Iterator[tuple[str, bool]]:
    """Each command of a page, and whether it is whole: what stands in a sentence may be a part."""
    for block in FENCED.findall(text):
        variables: dict[str, str] = {}
        for line in block.replace("\\\n", " ").splitlines():
            if assigned := re.fullmatch(r'(?:export )?([A-Z]+)="?([^"]*)"?', line):
                variables[assigned[1]] = assigned[2]
            for name, value in variables.items():
                line = re.sub(rf"\${name}\b", lambda _, value=value: value, line)
            yield line, True
    for found in re.finditer(r"(Made by )?`([^`\n]+)`", FENCED.sub("", text)):
        yield found[2], bool(found[1])


def words_of(line: str) -> tuple[str, list[str]] | None:
    """The program and its words; None where the line is none of ours."""
    for start, program in (
        ("blender --background --command arm ", "arm_blender"),
        ("python -m arm_blender ", "arm_blender"),
        (".venv/bin/python -m arm_blender ", "arm_blender"),
        ("arm ", "arm_blender"),
        ("arm-blender ", "arm_blender"),
        ("python -m training ", "training"),
        (".venv/bin/python -m training ", "training"),
    ):
        if line.startswith(start):
            return program, shlex.split(line.removeprefix(start).rstrip("& "), comments=True)
    if line.startswith("torchrun ") and " -m -- training " in line:
        return "training", shlex.split(line.partition(" -m -- training ")[2], comments=True)
    return None


def refusal(program: str, words: list[str]) -> str:
    """What the real parser says against the words; empty where it takes them."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            if program == "arm_blender":
                arm_parser().parse_args(words)
            else:
                understood(words)
    except SystemExit as stop:
        return said.getvalue() if stop.code else ""
    return ""


def test_every_command_line_is_understood(page, monkeypatch):
    monkeypatch.delenv("ARM_DATA", raising=False)
    for line, whole in command_lines(page.read_text(encoding="utf-8")):
        asked = words_of(line.strip())
        if asked is None:
            continue
        program, words = asked
        said = refusal(program, [word for word in words if word != "..."])
        partial = not whole or "..." in words
        if partial and ("are required" in said or "expected" in said or "one of the arguments" in said):
            continue
        assert not said, f"{name_of(page)}: {line}: {said}"


def test_every_make_target_and_extra_is_there(page):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"(?:^|`)make ([a-z][\w-]*)", text, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"{name_of(page)}: make {target}"
    for extra in re.findall(r"(?:arm-blender|\.)\[([a-z]+)\]'", text):
        assert extra in project["optional-dependencies"], f"{name_of(page)}: {extra}"
    for tool in re.findall(r"python ((?:tools|benchmarks)/\w+\.py)", text):
        assert (ROOT / tool).exists(), f"{name_of(page)}: {tool}"


def test_a_wrong_command_line_is_noticed():
    assert "--colour" in refusal("arm_blender", ["generate", "x", "--output", "y", "--colour"])
    assert refusal("training", ["evaluate", "--nothing"])
    assert refusal("arm_blender", ["generate", "x"])
    with pytest.raises(AssertionError):
        assert "no-such-anchor" in anchors(ROOT / "README.md")


def test_the_code_of_the_python_page_runs(tmp_path, monkeypatch):
    (code,) = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "docs" / "python-api.md").read_text(), re.DOTALL | re.MULTILINE
    )
    (tmp_path / "arm_blender").mkdir()
    (tmp_path / "arm_blender" / "examples").symlink_to(ROOT / "arm_blender" / "examples")
    monkeypatch.chdir(tmp_path)
    told: dict[str, object] = {}
    exec(compile(code, "python-api.md", "exec"), told)
    assert (tmp_path / "out" / "barrel" / "barrel.glb") in [path.resolve() for path in told["files"]]
    assert (tmp_path / "out" / "barrel" / "report.json").is_file()


@cache
def sentences() -> str:
    """Every text in the program's code, f-strings with … for what is filled in."""
    texts = []
    for path in (ROOT / "arm_blender").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values]
                texts.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


def test_every_message_of_the_troubleshooting_page_is_one_of_ours():
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    messages = re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE)
    assert len(messages) > 30
    assert not [message for message in messages if message not in sentences()]
