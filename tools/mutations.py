"""Mutations of a file: what transfers, disks and other programs do to one, and what somebody who wants harm would."""

import json
import random
import re
from typing import Any

WORDS = (b"\0", b"\xff" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0" * 8, b"1e999", b"nan", b"-1", b"9" * 400)
NUMBERS = (0, -1, 1, 2, 2**31, 2**63, 10**400, 1e308, 5e-324, -5e-324, float("nan"), float("inf"), 0.5, True)
OTHERS = (None, "", "x" * 5000, "\0", [], {}, [[]], {"a": {}}, "../../x", "\ud800")


def mutated(content: bytes, generator: random.Random) -> bytes:
    """`content` after one mutation or several."""
    for _ in range(generator.choice((1, 1, 1, 2, 3, 8))):
        content = generator.choice(MUTATIONS)(content, generator)
    return content


def _bits(content: bytes, generator: random.Random) -> bytes:
    if not content:
        return content
    found = bytearray(content)
    for _ in range(generator.choice((1, 2, 5, 30))):
        found[generator.randrange(len(found))] ^= 1 << generator.randrange(8)
    return bytes(found)


def _head(content: bytes, generator: random.Random) -> bytes:
    """Bytes near the beginning, where files say what they hold."""
    found = bytearray(content)
    for _ in range(generator.choice((1, 2, 4))):
        if found:
            found[generator.randrange(min(len(found), 256))] = generator.choice((0, 1, 127, 128, 255))
    return bytes(found)


def _cut(content: bytes, generator: random.Random) -> bytes:
    return content[: generator.randrange(len(content) + 1)]


def _hole(content: bytes, generator: random.Random) -> bytes:
    first, last = sorted(generator.randrange(len(content) + 1) for _ in range(2))
    return content[:first] + content[last:]


def _twice(content: bytes, generator: random.Random) -> bytes:
    first, last = sorted(generator.randrange(len(content) + 1) for _ in range(2))
    return content[:last] + content[first:]


def _word(content: bytes, generator: random.Random) -> bytes:
    place, word = generator.randrange(len(content) + 1), generator.choice(WORDS)
    return content[:place] + word + content[place + generator.choice((0, len(word))) :]


def _number(content: bytes, generator: random.Random) -> bytes:
    """Another number where one stands as text."""
    places = list(re.finditer(rb"-?\d+(\.\d+)?(e-?\d+)?", content))
    if not places:
        return content
    place = generator.choice(places)
    text = generator.choice(("0", "-1", "1", "2", "4294967296", "9" * 400, "1e999", "nan", "5e-324", "0.5", ""))
    return content[: place.start()] + text.encode() + content[place.end() :]


def _tree(content: bytes, generator: random.Random) -> bytes:
    """Another value somewhere in JSON, where the content is that, or has it after the head of a GLB or safetensors."""
    start = content.find(b"{")
    if not 0 <= start <= 24:
        return content
    try:
        data, length = json.JSONDecoder().raw_decode(content[start:].decode("utf-8", "surrogateescape"))
        text = content[start:].decode("utf-8", "surrogateescape")[:length]
        changed = json.dumps(_changed(data, generator)).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        return content
    own = len(text.encode("utf-8", "surrogateescape"))
    head = content[:start]
    # Blanks keep the lengths that a head states, where there is room.
    changed = changed.ljust(own) if generator.random() < 0.8 else changed
    if head[:4] == b"glTF" and len(head) == 20:
        changed += b" " * (-len(changed) % 4)
        head = head[:12] + len(changed).to_bytes(4, "little") + head[16:]
    elif len(head) == 8:
        head = len(changed).to_bytes(8, "little")
    return head + changed + content[start + own :]


def _changed(data: Any, generator: random.Random) -> Any:
    """`data` with one of its values replaced, removed or doubled."""
    if isinstance(data, dict) and data and generator.random() < 0.9:
        key = generator.choice(list(data))
        if generator.random() < 0.1:
            return {other: value for other, value in data.items() if other != key}
        return data | {key: _changed(data[key], generator)}
    if isinstance(data, list) and data and generator.random() < 0.9:
        place = generator.randrange(len(data))
        if generator.random() < 0.1:
            return data[:place] + data[place + generator.choice((0, 1)) :] + data[place : place + 1]
        return [*data[:place], _changed(data[place], generator), *data[place + 1 :]]
    return generator.choice(NUMBERS if generator.random() < 0.6 else OTHERS)


MUTATIONS = (_bits, _head, _cut, _hole, _twice, _word, _number, _number, _tree, _tree)
