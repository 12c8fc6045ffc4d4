"""A download is whole and verified under its name, or nothing is; what broke off goes on where it was."""

import hashlib
import random
import shutil
import urllib.request

import pytest

from arm_blender.errors import Cancelled, DownloadError, OutputError
from arm_blender.machine import fetch as module
from arm_blender.machine.fetch import PublishedFile, fetch

CONTENT = random.Random(0).randbytes(300_000)
OTHER = random.Random(1).randbytes(300_000)
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(module, "CHUNK", 1000)


def stopping_at(share: float):
    def progress(fraction, message):
        if fraction > share:
            raise Cancelled("stopped")

    return progress


def beside(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_arrives_whole_and_alone(publisher, tmp_path):
    heard = []
    file = publisher.published("a.ckpt", CONTENT, sha256=SHA256, size=len(CONTENT))
    path = fetch(file, tmp_path / "new" / "folder", lambda fraction, message: heard.append(fraction))
    assert path.read_bytes() == CONTENT and beside(path.parent) == ["a.ckpt"]
    assert heard == sorted(heard) and len(heard) > 100 and 0.0 <= heard[0] and heard[-1] <= 1.0
    fetch(file, path.parent)
    assert publisher.asked == [None]


def test_a_broken_connection_goes_on_where_it_was(publisher, tmp_path):
    publisher.breaks = [100_000, 0, 50_000]
    path = fetch(publisher.published("a.ckpt", CONTENT, sha256=SHA256), tmp_path)
    assert path.read_bytes() == CONTENT and publisher.sent == len(CONTENT)
    assert publisher.asked == [None, "bytes=100000-", "bytes=100000-", "bytes=150000-"]


def test_without_ranges_it_starts_anew(publisher, tmp_path):
    publisher.ranges, publisher.breaks = False, [100_000, 100]
    assert fetch(publisher.published("a.ckpt", CONTENT), tmp_path).read_bytes() == CONTENT
    assert publisher.sent == len(CONTENT) + 100_100


def test_without_a_validator_it_starts_anew(publisher, tmp_path):
    """A weak ETag does not promise the same bytes."""
    publisher.etag, publisher.breaks = 'W/"one"', [100_000]
    assert fetch(publisher.published("a.ckpt", CONTENT), tmp_path).read_bytes() == CONTENT
    assert publisher.asked == [None, None]


def test_without_a_length_the_hash_or_the_size_tells(publisher, tmp_path):
    publisher.length = False
    file = publisher.published("a.ckpt", CONTENT, sha256=SHA256)
    assert fetch(file, tmp_path / "whole").read_bytes() == CONTENT
    publisher.breaks = [1000, 1000]
    with pytest.raises(DownloadError, match="SHA-256"):
        fetch(file, tmp_path / "short")
    with pytest.raises(DownloadError, match="1000 bytes instead of 300000"):
        fetch(publisher.published("b.ckpt", CONTENT, size=len(CONTENT)), tmp_path / "short")


def test_a_stop_leaves_a_part_that_the_next_call_continues(publisher, tmp_path):
    file = publisher.published("a.ckpt", CONTENT, sha256=SHA256)
    with pytest.raises(Cancelled):
        fetch(file, tmp_path, stopping_at(0.5))
    assert beside(tmp_path) == ["a.ckpt.part", "a.ckpt.part.json"]
    have = (tmp_path / "a.ckpt.part").stat().st_size
    assert 0.4 * len(CONTENT) < have < len(CONTENT)
    assert fetch(file, tmp_path).read_bytes() == CONTENT
    assert publisher.asked == [None, f"bytes={have}-"] and beside(tmp_path) == ["a.ckpt"]


def test_a_stop_while_checking_downloads_nothing_again(publisher, tmp_path):
    file = publisher.published("a.ckpt", CONTENT, sha256=SHA256)

    def progress(fraction, message):
        if message.startswith("checking"):
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        fetch(file, tmp_path, progress)
    assert fetch(file, tmp_path).read_bytes() == CONTENT
    assert publisher.asked == [None]


@pytest.mark.parametrize("if_range", [True, False], ids=["If-Range", "only Range"])
def test_a_file_that_changed_is_not_mixed(publisher, tmp_path, if_range):
    publisher.if_range = if_range
    with pytest.raises(Cancelled):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path, stopping_at(0.5))
    publisher.etag = '"two"'
    assert fetch(publisher.published("a.ckpt", OTHER), tmp_path).read_bytes() == OTHER


def test_a_part_longer_than_the_file_of_today_is_dropped(publisher, tmp_path):
    publisher.if_range = False
    with pytest.raises(Cancelled):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path, stopping_at(0.5))
    assert fetch(publisher.published("a.ckpt", b"short"), tmp_path).read_bytes() == b"short"


@pytest.mark.parametrize("notes", [None, "{", "[]", '{"url": "http://elsewhere", "validator": "x", "total": 9}'])
def test_a_part_of_which_nothing_is_known_is_not_trusted(publisher, tmp_path, notes):
    (tmp_path / "a.ckpt.part").write_bytes(b"what is this")
    if notes is not None:
        (tmp_path / "a.ckpt.part.json").write_text(notes)
    assert fetch(publisher.published("a.ckpt", CONTENT), tmp_path).read_bytes() == CONTENT
    assert publisher.asked == [None]


def test_another_content_is_refused_and_not_kept(publisher, tmp_path):
    with pytest.raises(DownloadError, match=f"a.ckpt: its SHA-256 is .* instead of {SHA256}"):
        fetch(publisher.published("a.ckpt", OTHER, sha256=SHA256), tmp_path)
    with pytest.raises(DownloadError, match="300000 bytes instead of 299999"):
        fetch(publisher.published("b.ckpt", CONTENT, size=299_999), tmp_path)
    assert beside(tmp_path) == []


def test_the_beginning_of_a_hash_is_compared(publisher, tmp_path):
    assert fetch(publisher.published("a.pth", CONTENT, sha256=SHA256[:8].upper()), tmp_path).is_file()
    with pytest.raises(DownloadError, match="SHA-256"):
        fetch(publisher.published("b.pth", CONTENT, sha256="0" + SHA256[:7]), tmp_path)


@pytest.mark.parametrize(("status", "line"), [(404, r"any more \(404\)"), (401, "account"), (403, "account")])
def test_a_refusal_is_final(publisher, tmp_path, status, line):
    publisher.refusals = [status]
    with pytest.raises(DownloadError, match=f"http://127.*/a.ckpt: .*{line}"):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path)
    assert len(publisher.asked) == 1 and beside(tmp_path) == []


def test_a_server_in_trouble_is_asked_again_but_not_for_ever(publisher, tmp_path):
    publisher.refusals = [503, 429]
    assert fetch(publisher.published("a.ckpt", CONTENT), tmp_path).read_bytes() == CONTENT
    publisher.asked.clear()
    publisher.refusals = [503] * 10
    with pytest.raises(DownloadError, match="trouble"):
        fetch(publisher.published("b.ckpt", CONTENT), tmp_path)
    assert len(publisher.asked) == module.ATTEMPTS


def test_a_connection_that_always_breaks_ends_in_one_line(publisher, tmp_path):
    publisher.ranges, publisher.breaks = False, [1000] * 10
    with pytest.raises(DownloadError, match="broke off"):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path)
    assert len(publisher.asked) == 1 + module.ATTEMPTS and not (tmp_path / "a.ckpt").exists()


def test_a_server_that_is_not_there_is_named(publisher, tmp_path):
    with pytest.raises(DownloadError, match="http://127.0.0.1:9/a.ckpt: cannot be reached"):
        fetch(PublishedFile("a.ckpt", "http://127.0.0.1:9/a.ckpt", "1 GB"), tmp_path)
    assert beside(tmp_path) == []


def test_an_encrypted_address_never_leads_to_an_open_one():
    request = urllib.request.Request("https://publisher/a.ckpt")
    with pytest.raises(DownloadError, match="unencrypted"):
        module._Redirects().redirect_request(request, None, 302, "Found", {}, "http://elsewhere/a.ckpt")
    assert module._Redirects().redirect_request(request, None, 302, "Found", {}, "https://elsewhere/a.ckpt")


def test_a_disk_without_room_is_said_before_the_first_byte(publisher, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**6, 10**6, 1000))
    with pytest.raises(OutputError, match="no room"):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path)
    assert not (tmp_path / "a.ckpt").exists()


def test_a_folder_that_cannot_be_written_is_named(publisher, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file/a.ckpt.part: cannot be written"):
        fetch(publisher.published("a.ckpt", CONTENT), tmp_path / "file")
