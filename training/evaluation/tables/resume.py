"""Going on with an evaluation that was stopped: what its results.json has, if it is of the same trial."""

import json
import logging
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from ..scores.geometry import FAILED, GeometryScores
from ..scores.image_scores import ImageScores, ViewMoments
from ..scores.light import LightScores
from ..trials.measure import ObjectResult, SystemResult
from ..trials.trial import Trial
from .output import RESULTS, trial_record

logger = logging.getLogger(__name__)

Scores = TypeVar("Scores", GeometryScores, ImageScores, ViewMoments)


def kept_results(folder: Path, trial: Trial) -> dict[str, ObjectResult]:
    """The results of a folder by the objects' names; none where it has none, or those of another trial."""
    try:
        record = json.loads((folder / RESULTS).read_text(encoding="utf-8"))
        # By way of JSON, which knows no tuples.
        if record["trial"] != json.loads(json.dumps(trial_record(trial))):
            logger.info("%s: of another trial; measuring anew", folder / RESULTS)
            return {}
        return {item["name"]: _object(item) for item in record["objects"]}
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError) as error:
        logger.warning("%s: not readable (%s); measuring anew", folder / RESULTS, error)
        return {}


def _object(item: dict[str, Any]) -> ObjectResult:
    return ObjectResult(
        item["name"],
        item["kind"],
        {name: _system(system) for name, system in item["systems"].items()},
        _shape(item["ceiling"]),
        {name: [_scores(ViewMoments, view) for view in views] for name, views in item["moments"].items()},
        item["seconds"],
        None if item.get("light") is None else LightScores(**item["light"]),
    )


def _system(item: dict[str, Any]) -> SystemResult:
    maps = {name: _scores(ImageScores, scores) for name, scores in item["maps"].items()}
    geometry, aligned = (None if item[name] is None else _shape(item[name]) for name in ("geometry", "aligned"))
    return SystemResult(geometry, aligned, item["overlap"], maps)


def _shape(item: dict[str, Any]) -> GeometryScores:
    """Without a distance there was no surface: JSON knows no infinity."""
    return FAILED if item["chamfer"] is None else _scores(GeometryScores, item)


def _scores(kind: type[Scores], item: dict[str, Any]) -> Scores:
    return kind(**{field.name: item[field.name] for field in fields(kind)})
