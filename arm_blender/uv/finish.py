"""Maps as a user's finishes make them: roughness and metallic of whole regions, and the base colour of metals."""

from dataclasses import replace

import torch
from torch import Tensor

from ..structures import MaterialMaps, Regions


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
