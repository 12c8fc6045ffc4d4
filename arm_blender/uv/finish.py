"""Maps as a user's finishes make them: roughness and metallic of whole regions, and the base colour of metals."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..graphics.color import bytes_from_unit, srgb_from_linear
from ..knobs.finishes import finishes_of, name_of
from ..report import Report
from ..structures import MaterialMaps, Regions


def chosen_finishes(maps: MaterialMaps, words: str | None, report: Report) -> MaterialMaps:
    """The maps with a user's finishes beside them, and the regions in the report.

    Args:
        maps: as predicted.
        words: as `finishes_of` takes them; None sets none. A number that there is no region of makes the result
            doubtful rather than lost: nobody knows before how many there are.
        report: gets the list of regions.
    """
    regions = maps.regions
    if regions is not None and words is not None:
        asked = finishes_of(words)
        for number in sorted(set(asked) - set(range(1, regions.count + 1))):
            what = f"--finish {number}={name_of(asked[number])} was not used, as there is no region {number}"
            report.doubt(f"{what}; regions.png shows 1 to {regions.count}")
        regions = replace(regions, finishes={n: finish for n, finish in asked.items() if n <= regions.count})
        maps = replace(maps, regions=regions)
    report.regions, report.view_light = described(maps), None if regions is None else list(regions.light)
    predicted = {"roughness": maps.roughness, "metallic": maps.metallic}
    report.values = {name: texels for name, texels in predicted.items() if isinstance(texels, float)}
    return maps


def described(maps: MaterialMaps) -> list[dict[str, Any]]:
    """The regions as JSON types: number, share, swatch (sRGB, as #rrggbb), predicted means, and the finish or None."""
    regions = maps.regions
    if regions is None:
        return []
    found = []
    for number, (area, swatch) in enumerate(zip(regions.area, regions.swatch, strict=True), start=1):
        means = {}
        for name in ("roughness", "metallic"):
            texels = getattr(maps, name)
            if isinstance(texels, Tensor):
                inside = sized(regions.index, texels.shape[-1]) == number
                texels = float(texels[0][inside].mean()) if inside.any() else float(texels.mean())
            means[name] = round(texels, 4)
        finish = regions.finishes.get(number)
        color = bytes(bytes_from_unit(srgb_from_linear(torch.tensor(swatch))).tolist()).hex()
        found.append(
            {"number": number, "share": round(area, 4), "swatch": f"#{color}", **means}
            | {"finish": None if finish is None else name_of(finish)}
        )
    return found


def finished(maps: MaterialMaps) -> MaterialMaps:
    """The maps with the finishes of `maps.regions` in them; where none is set they are `maps` themselves.

    Roughness and metallic of a region become the finish's. So does its base colour as far as it is metallic:

        base = (1 - metallic) * albedo + metallic * remade

    A named metal is remade as its F0, of one colour: what the views show of polished metal is the room around it, which
    has no place in a base colour. A metal that has no name (plain numbers) is remade as the views' colour over their
    mean light, in [0, 1]: a metal sends back of the light from all around the share that its F0 is.

    The predicted maps are nowhere written over: the same maps without finishes are the prediction again.

    Returns:
        Maps of the sizes that `maps` have; a map that was one value has the texels of the regions, but where all
        regions have one value. `regions` go along.
    """
    regions = maps.regions
    if regions is None or not regions.finishes:
        return maps
    roughness = _set(maps.roughness, regions, {n: finish.roughness for n, finish in regions.finishes.items()})
    metallic = _set(maps.metallic, regions, {n: finish.metallic for n, finish in regions.finishes.items()})
    return replace(maps, albedo=_base_color(maps, regions), roughness=roughness, metallic=metallic)


def sized(index: Tensor, side: int) -> Tensor:
    """(side, side) region numbers: those at the centres of the texels of a map with another side."""
    if index.shape[-1] == side:
        return index
    # A texel of the map is as near to one of the index as to the next where it is larger; any of them will do.
    at = ((torch.arange(side, device=index.device) + 0.5) * (index.shape[-1] / side)).long()
    return index[at][:, at]


def _set(texels: Tensor | float, regions: Regions, values: dict[int, float]) -> Tensor | float:
    """(1, T, T), or a value, in which regions have the `values` by their numbers."""
    if isinstance(texels, float):
        if len(values) == regions.count and len(set(values.values())) == 1:
            return next(iter(values.values()))
        texels = torch.full((1, *regions.index.shape), texels, device=regions.index.device)
    elif texels.shape[-1] < regions.index.shape[-1]:  # Borders of regions stay as fine as they are.
        texels = torch.nn.functional.interpolate(texels[None], size=regions.index.shape, mode="bilinear")[0]
    index = sized(regions.index, texels.shape[-1])
    result = texels.clone()
    for number, value in values.items():
        result[0][index == number] = value
    return result


def _base_color(maps: MaterialMaps, regions: Regions) -> Tensor:
    """(3, T, T) albedo, remade where a finish is metallic."""
    index = sized(regions.index, maps.albedo.shape[-1])
    light = maps.baked.new_tensor(regions.light)[:, None]
    result = maps.albedo.clone()
    for number, finish in regions.finishes.items():
        if finish.metallic <= 0.0:
            continue
        inside = index == number
        remade = (maps.baked[:, inside] / light).clamp(0.0, 1.0)
        if finish.f0 is not None:
            remade = remade.new_tensor(finish.f0)[:, None].expand_as(remade)
        result[:, inside] += finish.metallic * (remade - result[:, inside])
    return result
