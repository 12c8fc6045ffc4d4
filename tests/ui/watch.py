"""What is watched while a scenario runs: the clock, the panel, the reports of the thread. Inside Blender."""

import time

import bpy
from window import area, module

TICK = 0.02
"""Seconds between two ticks of the clock that is watched."""
REDRAW = 0.1
"""Seconds from redraw to redraw of the panel: as often as the extension itself looks at its job. Drawn by the
processor, more of them would take from the run what a graphics card does not."""


class Watch:
    """When timers fired, the panel was drawn, and the thread reported; seconds on one clock."""

    def __init__(self) -> None:
        self.ticks: list[float] = []
        self.draws: list[tuple[float, str]] = []
        self.reports: list[tuple[float, str]] = []
        self._asked = 0.0
        bpy.app.timers.register(self._tick, persistent=True)

    def _tick(self) -> float:
        self.ticks.append(time.perf_counter())
        if self.ticks[-1] - self._asked >= REDRAW:
            self._asked = self.ticks[-1]
            next(region for region in area().regions if region.type == "UI").tag_redraw()
        return TICK

    def attach(self) -> None:
        """Listen to the panel's draws, and to the reports of jobs, as the extension has them now."""
        panel, job = module("generate.panel").ARM_PT_generate, module("job").Job
        draw, report = panel.draw, job._progress

        def drawn(shown, context) -> None:
            draw(shown, context)
            self.draws.append((time.perf_counter(), context.window_manager.arm.message))

        def reported(own, fraction: float, message: str) -> None:
            self.reports.append((time.perf_counter(), message))
            report(own, fraction, message)

        panel.draw, job._progress = drawn, reported

    def intervals(self, since: float) -> dict[str, dict[str, float]]:
        """Of timer events and of redraws: the longest interval and the 95th percentile."""
        found = {}
        for name, moments in (("timer events", self.ticks), ("redraws", [moment for moment, _ in self.draws])):
            inside = [moment for moment in moments if moment >= since]
            gaps = sorted(b - a for a, b in zip(inside, inside[1:], strict=False))
            found[name] = {"longest": gaps[-1], "p95": gaps[int(0.95 * (len(gaps) - 1))], "number": len(gaps)}
        return found

    def silences(self, since: float) -> dict[str, float]:
        """For each stage of a run the longest time that the thread went without a report: how late a stop may come."""
        inside = [(moment, stage_of(message)) for moment, message in self.reports if moment >= since]
        inside.append((time.perf_counter(), "end"))
        longest: dict[str, float] = {}
        for (begin, stage), (end, _) in zip(inside, inside[1:], strict=False):
            longest[stage] = max(longest.get(stage, 0.0), end - begin)
        return longest


def stage_of(message: str) -> str:
    """The pictures are one stage, whatever their names."""
    return "reading the pictures" if message.startswith("reading ") else message
