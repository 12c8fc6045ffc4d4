"""What a window's scenarios found, held against the bars, as a table. Standard library only."""

from dataclasses import dataclass

FREEZE = 0.25
"""Seconds between two timer events or redraws at most, and until the panel says that a wish to stop was heard."""
STOP = 1.0
"""Seconds until the thread of a run with `small` has ended."""

ENGINES = 0.1
"""By how much the mean colours of Cycles' and Eevee's previews may differ."""

PHOTOGRAPHS = 12
"""That the scenario makes and chooses."""


@dataclass(frozen=True)
class Check:
    """One line of the table.

    Attributes:
        what: was measured or looked at.
        found: in words, with unit.
        bar: in words; empty where there is none.
        held: the bar.
    """

    what: str
    found: str
    bar: str
    held: bool


def checks(found: dict[str, dict]) -> list[Check]:
    """The lines of the scenarios that ran; `found` is what each wrote, by its name."""
    return [check for name, maker in _MAKERS.items() if name in found for check in maker(found[name])]


def table(lines: list[Check]) -> str:
    """Markdown."""
    head = ["| what | found | bar | |", "| --- | ---: | ---: | --- |"]
    rows = [f"| {line.what} | {line.found} | {line.bar} | {'held' if line.held else '**missed**'} |" for line in lines]
    return "\n".join(head + rows)


def document(found: dict[str, dict], machine: str) -> str:
    """docs/user-interface.md."""
    silences = found["run"]["silences"]
    longest = "\n".join(f"| {stage} | {seconds:.2f} s |" for stage, seconds in silences.items())
    return f"""# The user interface, measured

`make test-ui` writes this page. It starts a real Blender with a window, clicks *Generate* for the example in
draft quality with the mouse, presses Esc at every stage, undoes, opens a file, quits and disables the extension while a
run is going on; it takes two clicks from nothing to a result; it goes from photographs to an asset: choose them,
*Solve Cameras*, *Edit Mask*, *Generate*; and it makes a region of a result chrome. It needs a Debian with root rights,
and fills a folder of its own (`.cache/blender-window`) with that Blender.

{machine}.

{table(checks(found))}
{_missing(found)}
*Says so*: from the key press to the first redraw of the panel with "Cancelling". *Ends*: from the key press to the
end of the thread; the stage is the one in which the key was pressed. Timer events were asked for every
0.02 s, and redraws of the panel every 0.1 s.

A stop is heard at the next report of the thread. So long a stage of an undisturbed run stayed silent at most:

| stage | longest silence |
| --- | ---: |
{longest}

![The panel idle, running, failed and done](images/panel.png)

A result that may be wrong says so, and why: here one of the views has a wrong camera.

![The panel of a doubtful result](images/panel-doubtful.png)
{_pictures(found)}"""


def _pictures(found: dict[str, dict]) -> str:
    """What scenarios besides *pictures* show, as far as they ran."""
    return "".join(text for name, text in (("example", _EXAMPLE), ("materials", _MATERIALS)) if name in found)


_EXAMPLE = """
Blender as it starts, the tab opened; and after *Example* and *Generate*. The cube hides the result, which is said.

![Nothing chosen, and the result of two clicks](images/panel-example.png)
"""

_MATERIALS = """
*Materials*: the regions of a result by *Show*, as predicted, and the one that a click picked as chrome.

![Regions, as predicted, one of them chrome](images/materials.png)
"""


def _missing(found: dict[str, dict]) -> str:
    """The scenarios that failed or were not run, as a paragraph."""
    absent = [name for name in _MAKERS if name not in found]
    return f"\nWithout a result: {', '.join(absent)}.\n" if absent else ""


def _run(found: dict) -> list[Check]:
    lines = [Check("a run, from the click to the result", f"{found['seconds']:.1f} s", "", not found["error"])]
    for name, gap in found["intervals"].items():
        held = gap["longest"] <= FREEZE
        lines.append(Check(f"longest interval between {name}", f"{gap['longest']:.3f} s", f"{FREEZE} s", held))
        lines.append(Check(f"95th percentile of {gap['number']}", f"{gap['p95']:.3f} s", "", True))
    undone = found["made"] > 0 and found["left after undo"] == 0
    said = f"{found['made']} made, {found['left after undo']} left"
    return [*lines, Check("one undo takes the result's objects away", said, "0 left", undone)]


def _example(found: dict) -> list[Check]:
    listed = (found["path"], found["views"], found["kind"]) == ("barrel", 6, "posed")
    made = f"{found['made']} made in {found['seconds']:.1f} s{': ' + found['error'] if found['error'] else ''}"
    hidden = found["hidden by"] or "nothing"
    undone = found["path after two undos"] or "no pictures"
    return [
        Check("one click on *Example*", f"{found['views']} views listed", "6", listed),
        Check("one more on *Generate*", made, "1 made", found["made"] == 1 and not found["error"]),
        Check("what is said to hide the result in Blender's start file", hidden, "Cube", hidden == "Cube"),
        Check("two undos give back what was chosen before", undone, "no pictures", undone == "no pictures"),
    ]


def _cancel(found: dict) -> list[Check]:
    lines = []
    for stage, row in found["stages"].items():
        if row is None:
            lines.append(Check(f"Esc at *{stage}*", "not reached in time", f"{FREEZE} s, {STOP} s", False))
            continue
        if not row["stopped"]:
            lines.append(Check(f"Esc at *{stage}*", "the run was over first", "", True))
            continue
        if row["said"] is None:
            said, heard = "over before the next redraw", row["ended"] <= FREEZE
        else:
            said, heard = f"says so after {row['said']:.3f} s", row["said"] <= FREEZE
        held = heard and row["ended"] <= STOP
        ended = f"ends after {row['ended']:.2f} s"
        lines.append(Check(f"Esc at *{stage}*", f"{said}, {ended}", f"{FREEZE} s, {STOP} s", held))
    return lines


def _load(found: dict) -> list[Check]:
    held = found["ended"] and not found["running"] and found["runs again"]
    return [Check("a file opened during a run", f"open after {found['seconds']:.2f} s, the thread ended", "", held)]


def _quit(found: dict) -> list[Check]:
    return [Check("Blender closed during a run", "exit code 0", "exit code 0", found["running"])]


def _disable(found: dict) -> list[Check]:
    held = found["ended"] and found["gone"] and found["back"]
    return [Check("the extension disabled during a run", f"ended after {found['seconds']:.2f} s", "", held)]


def _engines(found: dict) -> list[Check]:
    lines = []
    for environment, colors in found["mean colors"].items():
        cycles, eevee = (sum(colors[engine]) / 3.0 for engine in ("cycles", "eevee"))
        what = f"mean colour of Eevee's preview under *{environment}* against Cycles'"
        bar, held = f"within {ENGINES:.0%}", abs(eevee / cycles - 1.0) <= ENGINES
        lines.append(Check(what, f"{eevee:.3f} against {cycles:.3f} ({eevee / cycles - 1.0:+.1%})", bar, held))
    return lines


def _photographs(found: dict) -> list[Check]:
    views = sum(bool(view) for _, view, _ in found["rows"])
    solved = f"{found['cameras']} cameras{', ground' if found['ground'] else ''} in {found['seconds']:.1f} s"
    told = [short for name, _, short in found["rows after"] if short == "painted mask"]
    made = f"{found['made']} made{': ' + found['error'] if found['error'] else ''}"
    listed = found["browser"] and found["listed"] == PHOTOGRAPHS == len(found["rows"])
    return [
        Check("photographs chosen in the file browser", f"{found['listed']} listed", f"{PHOTOGRAPHS}", listed),
        Check("*Solve Cameras*", solved, "a camera a view", found["cameras"] == views > 0),
        Check(
            "*Edit Mask* opens the mask to be painted beside its picture",
            " and ".join(found["editors"]),
            "PAINT and VIEW",
            found["editors"] == ["PAINT", "VIEW"] and found["painted"],
        ),
        Check("*Generate* takes it", f"{made}, {len(told)} painted", "1 painted", len(told) == 1 <= found["made"]),
    ]


def _doubtful(found: dict) -> list[Check]:
    said = "; ".join(found["doubts"]) or "nothing said"
    return [Check("a result of which one view has a wrong camera", said, "doubtful", "002.png" in said)]


def _materials(found: dict) -> list[Check]:
    said = f"region {found['picked']} of {found['regions']}"
    picked = found["panel"] and found["picked"] == found["expected"] and found["left by Esc"]
    made = found["set"] == {str(found["picked"]): 1.0}
    undone = f"{len(found['set'])} set, {found['left after undo']} left"
    return [
        Check("*Pick on Object*: a click, after one that Esc left", said, f"region {found['expected']}", picked),
        Check("*Chrome* and one undo", undone, "1 set, 0 left", made and found["left after undo"] == 0),
    ]


_MAKERS = {
    "example": _example,
    "run": _run,
    "cancel": _cancel,
    "load": _load,
    "quit": _quit,
    "disable": _disable,
    "engines": _engines,
    "photographs": _photographs,
    "doubtful": _doubtful,
    "materials": _materials,
}
