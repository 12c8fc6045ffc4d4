"""The evaluation in words and tables: means per set, a row per object, and what does not beat its baseline."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from statistics import fmean
from typing import Any

from ...documents import markdown_table
from ..scores.geometry import LOWER_IS_BETTER, MEASURES
from ..scores.image_scores import best_constant, constant_score
from ..trials.measure import BLEND, HULL, MAPS, ONE_VIEW, OURS, SCALED, ObjectResult
from .bars import Reader, geometry_score, map_score, mean

TRAINING_MEAN = {"roughness": 0.44, "metallic": 0.18}
"""Of the 27 training objects that have measured maps (set `pbr`): the mean over the pixels of their rendered rigs, then
over the objects. It is what a constant would say that never saw the evaluation."""


def means_table(results: Sequence[ObjectResult], kind: str) -> str:
    """Markdown: a row per system with its means over the objects of one set."""
    header = ["system", *MEASURES.values(), *(f"{name}, aligned" for name in MEASURES.values()), "IoU"]
    header += [f"{name} {what}" for name in (*MAPS[:1], SCALED, *MAPS[1:]) for what in ("in", "full", "SSIM", "LPIPS")]
    rows = []
    for system in dict.fromkeys(name for result in results for name in result.systems):
        numbers = [mean(results, (kind,), system, read) for read in _readers()]
        rows.append([system, *(_digits(value, column) for column, value in zip(header[1:], numbers, strict=True))])
    return markdown_table(*without_empty(header, rows))


def objects_table(results: Sequence[ObjectResult]) -> str:
    """Markdown: a row per object, ours beside the hull, and the geometry's ceiling."""
    header = ["object", "set", "F@0.1", "hull", "ceiling", "F@0.02", "hull", "ceiling", "CD", "hull", "ceiling"]
    header += [MEASURES["angle"], "hull", "ceiling", "IoU"]
    header += [f"{name} in" for name in MAPS] + ["plain blend in", "one view F@0.1", "seconds"]
    header += ["light, dB", "re-rendered in"]
    rows = []
    for result in sorted(results, key=lambda r: (r.kind, r.name)):
        ours, hull = result.systems[OURS], result.systems[HULL]
        row: list[Any] = [result.name, result.kind]
        for name, title in MEASURES.items():
            shapes = (ours.geometry or ours.aligned, hull.geometry, result.ceiling)
            row += [_digits(getattr(shape, name), title) for shape in shapes]
        row.append(_digits(ours.overlap, "IoU"))
        row += [_digits(ours.maps[name].psnr_in if name in ours.maps else None, "in") for name in MAPS]
        blend, one = result.systems.get(BLEND), result.systems.get(ONE_VIEW)
        row.append(_digits(blend.maps["albedo"].psnr_in if blend else None, "in"))
        row.append(_digits(one.geometry.f_coarse if one and one.geometry else None, "F"))
        row.append(_digits(sum(result.seconds.values()) or None, "in"))
        light = result.light
        told = (None, None) if light is None else (light.irradiance, light.rerendering)
        rows.append([*row, *(_digits(value, "in") for value in told)])
    return markdown_table(*without_empty(header, rows))


def verdicts(results: Sequence[ObjectResult]) -> str:
    """A sentence for every network against every baseline of its own: what does not beat it is said so."""
    sentences = []
    for kind in sorted({result.kind for result in results}):
        chosen = [result for result in results if result.kind == kind]
        for name, title in MEASURES.items():
            read = geometry_score(name)
            pair = mean(chosen, (), OURS, read), mean(chosen, (), HULL, read)
            sentences.append(_sentence(f"{kind}, {title}: GeoRM", "the visual hull", *pair, name in LOWER_IS_BETTER))
        albedo = map_score("albedo", "psnr_in")
        pair = mean(chosen, (), OURS, albedo), mean(chosen, (), BLEND, albedo)
        sentences.append(_sentence(f"{kind}, albedo: InstantAlbedo", "plain blending of the views", *pair))
        for name in ("lit", "relit"):
            read = map_score(name, "psnr_in")
            pair = mean(chosen, (), OURS, read), mean(chosen, (), HULL, read)
            sentences.append(_sentence(f"{kind}, {name}: the asset", "the coloured hull", *pair))
        lights = [result.light for result in chosen if result.light is not None]
        if lights:
            irradiance, again = (
                fmean(getattr(light, name) for light in lights) for name in ("irradiance", "rerendering")
            )
            found = f"{irradiance:.1f} dB of its irradiance, and the views drawn under it {again:.1f} dB"
            sentences.append(f"{kind}, light: {found}, in the mean of {len(lights)} objects.")
        for name in ("roughness", "metallic"):
            seen = [result.moments[name] for result in chosen if result.moments.get(name)]
            ours = mean(chosen, (), OURS, map_score(name, "psnr_in"))
            if not seen:
                continue
            value, score = best_constant(seen)
            sentences.append(_sentence(f"{kind}, {name}: the finish", f"the best constant, {value:.2f},", ours, score))
            usual = TRAINING_MEAN[name]
            text = f"the training mean, {usual:.2f},"
            sentences.append(_sentence(f"{kind}, {name}: the finish", text, ours, constant_score(seen, usual)))
    return "  \n".join(sentence for sentence in sentences if sentence)


def as_json(results: Sequence[ObjectResult]) -> list[dict[str, Any]]:
    """Everything that was measured; what is infinite becomes null."""
    return [finite(asdict(result)) for result in results]


def finite(value: Any) -> Any:
    """The same without infinities and NaN, which JSON does not know."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _sentence(subject: str, baseline: str, ours: float | None, theirs: float | None, lower: bool = False) -> str:
    if ours is None or theirs is None:
        return ""
    better = ours < theirs if lower else ours > theirs
    digits = 3 if max(abs(ours), abs(theirs)) < 2.0 else 2
    word = "beats" if better else "does NOT beat"
    return f"{subject} {word} {baseline} ({ours:.{digits}f} against {theirs:.{digits}f})."


def _readers() -> list[Reader]:
    readers = [geometry_score(name) for name in MEASURES]
    readers += [geometry_score(name, "aligned") for name in MEASURES]
    readers.append(lambda result: result.overlap)
    for name in (*MAPS[:1], SCALED, *MAPS[1:]):
        readers += [map_score(name, score) for score in ("psnr_in", "psnr_full", "ssim", "lpips")]
    return readers


def _digits(value: float | None, column: str) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.1f}" if column.endswith(("in", "full")) or "°" in column else f"{value:.3f}"


def without_empty(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """The table without columns that nobody has a number for."""
    kept = [column for column in range(len(header)) if any(row[column] != "-" for row in rows)]
    return [header[k] for k in kept], [[row[k] for k in kept] for row in rows]
