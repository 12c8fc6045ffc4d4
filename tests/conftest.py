"""A publisher on this machine, as unreliable as those on the web; a folder for weights; a model that finds objects."""

import http.server
import threading
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from arm_blender.machine import fetch
from arm_blender.weight_files import checkpoints


@dataclass
class Publisher:
    """What the server has, how it behaves, and what it was asked."""

    address: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    etag: str = '"one"'
    ranges: bool = True
    """Whether it knows the header Range."""
    if_range: bool = True
    """Whether it also knows If-Range."""
    length: bool = True
    """Whether it says how long a file is."""
    breaks: list[int] = field(default_factory=list)
    """Of the next answers, after how many bytes the connection breaks."""
    refusals: list[int] = field(default_factory=list)
    """Status of the next answers."""
    asked: list[str | None] = field(default_factory=list)
    """The header Range of each request."""
    sent: int = 0
    """Bytes of content in all."""

    def published(self, name: str, content: bytes, **known) -> fetch.PublishedFile:
        self.files[f"/{name}"] = content
        return fetch.PublishedFile(name, f"{self.address}/{name}", f"{len(content)} bytes", **known)

    def answer(self, request: http.server.BaseHTTPRequestHandler) -> None:
        wanted = request.headers.get("Range")
        self.asked.append(wanted)
        content = self.files.get(request.path)
        if self.refusals or content is None:
            request.send_error(self.refusals.pop(0) if self.refusals else 404)
            return
        if not self.ranges or (self.if_range and request.headers.get("If-Range", self.etag) != self.etag):
            wanted = None
        start = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted else 0
        if start >= len(content):
            request.send_error(416)
            return
        request.send_response(206 if wanted else 200)
        request.send_header("ETag", self.etag)
        if wanted:
            request.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        if self.length:
            request.send_header("Content-Length", str(len(content) - start))
        request.end_headers()
        piece = content[start:]
        if self.breaks:
            piece = piece[: self.breaks.pop(0)]
        self.sent += len(piece)  # Before the client can have them all, and look.
        request.wfile.write(piece)


@pytest.fixture
def publisher(monkeypatch):
    monkeypatch.setattr(fetch, "PAUSE", 0.0)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    published = Publisher()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            published.answer(self)

        def log_message(self, *words):
            """Keeps the tests' output clean."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        published.address = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield published
        server.shutdown()
        thread.join()


@pytest.fixture
def weights_folder(tmp_path, monkeypatch) -> Path:
    """Where weights are installed during a test; empty."""
    place = tmp_path / "weights"
    place.mkdir()
    for function in (checkpoints.shipped, checkpoints.verify, checkpoints.condition):
        monkeypatch.setattr(function, "__defaults__", (place,))
    return place


@pytest.fixture
def matting_model():
    """Writes an ONNX model with the input and the output of U2-Net (320) or IS-Net (1024).

    Its mask is relu(w . rgb + b) of the normalised colours of each pixel.
    """

    def write(path: Path, side: int | str = 320, w=(1.0, -1.0, 0.0), b: float = 0.0, channels: int = 3) -> Path:
        import onnx
        from onnx import TensorProto, helper

        nodes = [helper.make_node("Conv", ["in", "w", "b"], ["linear"]), helper.make_node("Relu", ["linear"], ["mask"])]
        constants = [
            helper.make_tensor("w", TensorProto.FLOAT, (1, channels, 1, 1), w[:channels]),
            helper.make_tensor("b", TensorProto.FLOAT, (1,), [b]),
        ]
        places = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ("batch", depth, side, side))
            for name, depth in (("in", channels), ("mask", 1))
        ]
        graph = helper.make_graph(nodes, "matting", places[:1], places[1:], constants)
        onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
        return path

    return write
