"""One published file from the web: resumed where it broke off, verified, and under its name only when it is whole.

What has arrived lies beside it as NAME.part, with what is known of it in NAME.part.json, until the rest is there. A
part is continued only where the server shows that the file is still the same (RFC 9110, sections 13.1.5 and 14).
"""

import hashlib
import http.client
import json
import os
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from http.client import HTTPMessage
from pathlib import Path
from typing import IO

from ..errors import DownloadError, OutputError
from ..progress import Progress, part, silent
from ..version import VERSION

CHUNK = 2**18
"""Bytes between two looks at whether the user has stopped."""

TIMEOUT = 30.0
"""Seconds without a byte after which a connection counts as broken."""

ATTEMPTS = 3
"""Connections in a row that bring nothing new before we give up."""

PAUSE = 1.0
"""Seconds between two attempts."""

_VERIFYING = 0.9
"""Of the progress, where the bytes are there and their hash is not."""


@dataclass(frozen=True)
class PublishedFile:
    """A file that somebody else publishes.

    Attributes:
        name: as its publisher calls it.
        url: where it is.
        about: its size for reading, such as "1.5 GB".
        size: its bytes; None where nobody states them.
        sha256: hex, or its beginning; empty where nobody states it.
    """

    name: str
    url: str
    about: str
    size: int | None = None
    sha256: str = ""


def fetch(file: PublishedFile, folder: Path, progress: Progress = silent) -> Path:
    """Downloads `file` into `folder`; the caller has made sure that the user wants it. Knows nothing of bpy.

    Args:
        progress: told of every piece. When it raises, what has arrived stays as a part for the next call.
    Returns:
        The whole file, `folder / file.name`. One that is there already is returned as it is.
    Raises:
        DownloadError: the server cannot be reached, refuses, or sends something else.
        OutputError: the folder cannot be written, or has no room.
        Cancelled: by `progress`.
    """
    final = folder / file.name
    if final.is_file():
        return final
    arrived = _Part(folder / f"{file.name}.part", file.url)
    _receive_all(file, arrived, part(progress, 0.0, _VERIFYING))
    _verify(file, arrived, part(progress, _VERIFYING, 1.0))
    with _writing(final):
        os.replace(arrived.path, final)
    arrived.drop()
    return final


@dataclass(frozen=True)
class _Known:
    """What the server said of the file that a part belongs to; `validator` is for If-Range, empty where it has none."""

    url: str
    validator: str
    total: int | None


class _Part:
    """The bytes that have arrived, and what is known of the rest."""

    def __init__(self, path: Path, url: str) -> None:
        self.path = path
        self.notes = path.with_name(f"{path.name}.json")
        self.url = url

    @property
    def size(self) -> int:
        return self.path.stat().st_size if self.path.is_file() else 0

    @property
    def share(self) -> float:
        """How much has arrived of a file whose length is known, in [0, 1]."""
        known = self.known()
        return self.size / known.total if known is not None and known.total else 0.0

    def known(self) -> _Known | None:
        """None where nothing has arrived that could be continued."""
        try:
            known = _Known(**json.loads(self.notes.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):  # None yet, or of a run that broke while it wrote them.
            return None
        return known if known.url == self.url and self.size else None

    def begin(self, known: _Known) -> None:
        """A new part, empty."""
        with _writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_bytes(b"")
            self.notes.write_text(json.dumps(asdict(known)), encoding="utf-8")

    def drop(self) -> None:
        """Nothing is left of it."""
        with _writing(self.path):
            self.path.unlink(missing_ok=True)
            self.notes.unlink(missing_ok=True)


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows a publisher to its servers, but never from an encrypted connection to an open one."""

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> urllib.request.Request | None:
        if req.full_url.startswith("https:") and not newurl.startswith("https:"):
            raise DownloadError(f"{req.full_url}: leads to an unencrypted address")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _receive_all(file: PublishedFile, arrived: _Part, progress: Progress) -> None:
    """Connects until everything is there, or nothing more comes."""
    barren = 0
    while arrived.share != 1.0:
        before = arrived.size
        try:
            if _receive(file, arrived, progress):
                return
            reason = "the connection broke off"
        except urllib.error.HTTPError as error:
            reason = _refusal(file, arrived, error)
        except (OSError, http.client.HTTPException) as error:
            reason = f"cannot be reached ({getattr(error, 'reason', None) or error or type(error).__name__})"
        barren = 0 if arrived.size > before else barren + 1
        if barren == ATTEMPTS:
            raise DownloadError(f"{file.url}: {reason}")
        progress(arrived.share, f"waiting for {file.name}")
        time.sleep(PAUSE)


def _receive(file: PublishedFile, arrived: _Part, progress: Progress) -> bool:
    """One connection; whether the file is whole at its end."""
    headers = {"User-Agent": f"arm_blender/{VERSION}", "Accept-Encoding": "identity"}
    known = arrived.known()
    if known is not None and known.validator:
        headers |= {"Range": f"bytes={arrived.size}-", "If-Range": known.validator}
    request = urllib.request.Request(file.url, headers=headers)
    with urllib.request.build_opener(_Redirects).open(request, timeout=TIMEOUT) as response:
        if response.status == 206:
            if known is None or not _continues(response, known, arrived.size):
                arrived.drop()
                return False
            total = known.total
        else:
            length = response.headers.get("Content-Length", "")
            total = int(length) if length.isdigit() else None
            arrived.begin(_Known(file.url, _validator(response), total))
        if total is not None and file.size not in (None, total):
            arrived.drop()  # Said before gigabytes have come.
            raise DownloadError(f"{file.url}: has {total} bytes instead of {file.size}; nothing of it was kept")
        _check_room(arrived, total)
        message = f"downloading {file.name} ({file.about})"
        done = arrived.size
        with _writing(arrived.path):
            sink = arrived.path.open("ab", buffering=0)  # So that a full disk is noticed where it is written to.
        with sink:
            while total is None or done < total:
                progress(done / total if total else 0.0, message)
                # One read of the socket, so that a slow line does not hold back a stop.
                piece = response.read1(CHUNK if total is None else min(CHUNK, total - done))
                if not piece:
                    break
                done += len(piece)
                with _writing(arrived.path):
                    while piece:
                        piece = piece[sink.write(piece) :]
    return done == total if total is not None else True


def _validator(response: http.client.HTTPResponse) -> str:
    """What If-Range may hold: a strong ETag, or else the date of the last change."""
    etag = response.headers.get("ETag", "")
    return etag if etag.startswith('"') else response.headers.get("Last-Modified", "")


def _continues(response: http.client.HTTPResponse, known: _Known | None, have: int) -> bool:
    """Whether the answer 206 goes on where the part ends, and belongs to the same file.

    Some servers honour Range and pass over If-Range: then the ETag tells.
    """
    place = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
    if place is None or known is None or int(place[1]) != have or place[2] not in (str(known.total), "*"):
        return False
    return _validator(response) in ("", known.validator)


def _refusal(file: PublishedFile, arrived: _Part, error: urllib.error.HTTPError) -> str:
    """What an error status means; raises where another attempt would get the same answer."""
    if error.code == 416:  # The part is longer than what is there now.
        arrived.drop()
        return "the part does not belong to the file any more"
    if error.code in (401, 403):
        raise DownloadError(f"{file.url}: refused ({error.code}); its publisher may ask for an account")
    if error.code < 500 and error.code not in (408, 429):
        raise DownloadError(f"{file.url}: is not there any more ({error.code})")
    return f"its server is in trouble ({error.code})"


def _check_room(arrived: _Part, total: int | None) -> None:
    missing = 0 if total is None else total - arrived.size
    if shutil.disk_usage(arrived.path.parent).free < missing:
        raise OutputError(f"{arrived.path.parent}: no room for {missing / 1e6:.0f} MB more; free some and start again")


def _verify(file: PublishedFile, arrived: _Part, progress: Progress) -> None:
    """Raises `DownloadError`, and drops the part, where its size or its hash is not the published one."""
    if file.size not in (None, arrived.size):
        size = arrived.size
        arrived.drop()
        raise DownloadError(f"{file.url}: has {size} bytes instead of {file.size}; nothing of it was kept")
    if not file.sha256:
        return
    found, done, total = hashlib.sha256(), 0, max(arrived.size, 1)
    with arrived.path.open("rb") as source:
        while piece := source.read(2**22):
            progress(done / total, f"checking {file.name}")
            found.update(piece)
            done += len(piece)
    if not found.hexdigest().startswith(file.sha256.lower()):
        arrived.drop()
        raise DownloadError(
            f"{file.url}: its SHA-256 is {found.hexdigest()} instead of {file.sha256}; nothing of it was kept"
        )


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Tells an error of the disk from one of the network."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); free space or check its rights") from error
