"""What the extension says of its properties and operators keeps Blender's human interface guidelines."""

import inspect

import pytest

import arm_blender

bpy = pytest.importorskip("bpy")

pytestmark = pytest.mark.blender

SMALL = {"a", "an", "and", "as", "by", "for", "from", "in", "its", "of", "on", "or", "the", "to", "with"}
"""Words that stay small in a title."""
INTERNAL = {"views", "photographs", "views_of", "views_kind", "sees", "way", "doubt", "view", "picture"}
INTERNAL |= {"directory", "files", "filepath", "filter_folder", "filter_image", "filter_movie", "filter_glob"}
INTERNAL |= {"registered", "doubtful", "short", "whole", "fraction", "message", "time", "error", "views_error"}
INTERNAL |= {"told", "newest", "hidden_by"}
"""Never shown as properties."""


@pytest.fixture
def extension(empty_file):
    arm_blender.register()
    yield
    arm_blender.unregister()


def ours(kind: type) -> list[type]:
    return [cls for cls in kind.__subclasses__() if cls.is_registered and cls.__module__.startswith("arm_blender.")]


def declared(extension) -> list[tuple[str, bpy.types.Property]]:
    """Every property that is shown somewhere, with the name of what it belongs to."""
    found = []
    for kind in (bpy.types.PropertyGroup, bpy.types.AddonPreferences):
        for cls in ours(kind):
            found += [(cls.__name__, cls.bl_rna.properties[name]) for name in cls.__annotations__]
    for name in ("arm_view", "arm_region", "arm_region_roughness", "arm_region_metallic"):
        found.append(("Material", bpy.types.Material.bl_rna.properties[name]))
    for cls in ours(bpy.types.Operator):
        known = getattr(bpy.ops.arm, cls.bl_idname.partition(".")[2]).get_rna_type().properties
        found += [(cls.__name__, known[name]) for name in inspect.get_annotations(cls) if name in known]
    return [(owner, made) for owner, made in found if made.identifier not in INTERNAL]


def is_title(text: str) -> bool:
    words = [word for word in text.replace("(", "").split() if word[0].isalpha()]
    return all(word[0].isupper() or (word in SMALL and place > 0) for place, word in enumerate(words))


def is_sentence(text: str) -> bool:
    """It begins as a sentence does, is more than the label again, and has no period at its end."""
    return len(text) > 10 and not text[0].islower() and not text.endswith(".")


def test_every_property_has_a_title_and_a_description(extension):
    found = declared(extension)
    assert len(found) > 40
    bad = [f"{owner}.{made.identifier}: {made.name!r}" for owner, made in found if not is_title(made.name)]
    for owner, made in found:
        if not is_sentence(made.description):
            bad.append(f"{owner}.{made.identifier}: {made.description!r}")
        for item in made.enum_items if made.type == "ENUM" else ():
            if not is_title(item.name) or item.description.endswith(".") or not item.description:
                bad.append(f"{owner}.{made.identifier}.{item.identifier}: {item.name!r}, {item.description!r}")
    assert not bad, "\n".join(bad)


def test_every_operator_has_a_title_and_a_description(extension):
    found = ours(bpy.types.Operator)
    assert len(found) > 15
    bad = [cls.bl_label for cls in found if not is_title(cls.bl_label)]
    bad += [cls.__name__ for cls in found if not is_sentence(getattr(cls, "bl_description", "") or cls.__doc__ or "")]
    bad += [cls.bl_label for cls in ours(bpy.types.Panel) if not is_title(cls.bl_label)]
    assert not bad, bad


@pytest.mark.parametrize("word", ["chamfer", "dB", "texel", "PSNR"])
def test_no_measure_of_researchers_is_in_the_panel_s_words(extension, word):
    said = [f"{made.name} {made.description}" for _, made in declared(extension)]
    assert not [text for text in said if word.lower() in text.lower().split()]
