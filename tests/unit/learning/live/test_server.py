"""The page is read-only, for this machine alone, and whatever its readers do, the run learns on as without it."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.learning import rundir
from steerkit.learning.live import server as live
from steerkit.learning.live.server import Server, listening
from tests.support.browser import BROWSER, FRAME, FRAME_JS, shown

SLOW = 60.0
"""A process that takes longer than this hangs [s]; the machine may be busy."""
CONFIG = """minutes = 1.0
seed = 2
[scenario]
course = 'circle'
[setting]
retrain_every_m = 20.0
[setting.fit]
nets = 1
epochs = 30
"""


@contextlib.contextmanager
def serving(place: Path) -> Iterator[int]:
    """A server in this process; its port."""
    with listening(0) as it, Server(it, place) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        yield it.getsockname()[1]
        server.shutdown()
        thread.join()


def answer(port: int, path: str = "/", method: str = "GET", **headers: str) -> http.client.HTTPResponse:
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=SLOW)
    link.request(method, path, headers=headers)
    return link.getresponse()


def raw(port: int, data: bytes) -> bytes:
    """What comes back for these bytes, until the server has enough."""
    with socket.create_connection(("127.0.0.1", port), timeout=SLOW) as link:
        with contextlib.suppress(OSError):
            link.sendall(data)
            link.shutdown(socket.SHUT_WR)
        back = b""
        with contextlib.suppress(OSError):
            while more := link.recv(65536):
                back += more
        return back


# ---- what is served -------------------------------------------------------------------------------------------------


def test_the_page_needs_nothing_from_elsewhere(kept: Path) -> None:
    with serving(kept) as port:
        page = answer(port)
        assert (page.status, page.headers["Content-Type"]) == (200, "text/html; charset=utf-8")
        assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        assert "Access-Control-Allow-Origin" not in page.headers
        text = page.read().decode()
        wanted = re.findall(r'(?:src|href)="([^"]+)"', text)
        assert sorted(wanted) == ["data:,", "page.css", "page.js"]
        for name in ("page.css", "page.js"):
            part = answer(port, f"/{name}")
            assert part.status == 200
            code = part.read().decode()
            assert not re.search(r"url\(|@import|import\(|innerHTML|eval\(|style=", code)
            assert [found for found in re.findall(r"https?://\S+", code) if "www.w3.org/2000/svg" not in found] == []
        assert not re.search(r"https?://|style=|onload|<script>", text)
        ids = set(re.findall(r'id="([\w-]+)"', text))
        script = answer(port, "/page.js").read().decode()
        assert set(re.findall(r'(?:at|sheet)\("([\w-]+)"\)', script)) <= ids
        told = json.loads(answer(port, "/run.json?now").read())
        assert told["updates"] == rundir.load(kept).counts.updates


def test_the_names_that_the_page_reads_are_those_that_are_told(kept: Path) -> None:
    with serving(kept) as port:
        told = json.loads(answer(port, "/run.json").read())
        script = answer(port, "/page.js").read().decode()
    parts = {"run": told, **{name: told[name] for name in ("map", "policy", "curve", "ends", "limits")}}
    for name in set(re.findall(r"\brun\.(\w+)", script)) - {"json"}:
        assert name in told, name
    for part, name in set(re.findall(r"\brun\.(map|policy|curve|ends|limits)\.(\w+)", script)):
        assert name in parts[part], (part, name)
    for letter, part in (("c", "curve"), ("m", "map"), ("p", "policy")):
        body = script[script.index(f"{letter} = run.{part}") :].partition("\n}\n")[0]
        names = set(re.findall(rf"\b{letter}\.([a-z]\w*)", body)) - {"toFixed"}
        assert len(names) >= 4
        assert names <= set(told[part]), (part, names - set(told[part]))


@pytest.mark.parametrize(
    "host", ["evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:{port}", "[::1]:{port}", ""]
)
def test_a_page_of_another_site_whose_name_points_here_is_refused(host: str, tmp_path: Path) -> None:
    with serving(tmp_path) as port:
        for path in ("/", "/run.json"):
            assert answer(port, path, Host=host.format(port=port)).status == 403
        assert answer(port, Host=f"localhost:{port}").status == 200
        two = f"GET /run.json HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nHost: evil.example\r\n\r\n"
        assert raw(port, two.encode()).startswith(b"HTTP/1.0 403")
        assert b"trouble" not in raw(port, b"GET /run.json HTTP/1.0\r\n\r\n")


def test_it_can_only_be_read_and_only_what_is_its(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("sesame")
    with serving(tmp_path) as port:
        for method in ("POST", "PUT", "DELETE", "PATCH", "HEAD", "OPTIONS", "TRACE"):
            refused = answer(port, "/run.json", method)
            assert (refused.status, refused.headers["Allow"]) == (405, "GET"), method
        assert answer(port, "/", "BREW").status == 501
        for path in (
            "/secret",
            "/../secret",
            "//secret",
            "/%2e%2e/secret",
            "/index.html",
            "/page",
            "*",
            f"{tmp_path}/secret",
        ):
            found = answer(port, path)
            assert found.status == 404, path
            assert b"sesame" not in found.read()
    with pytest.raises(OSError, match="refused"):
        answer(port)


def test_without_a_run_and_with_a_broken_one_it_says_so(tmp_path: Path) -> None:
    with serving(tmp_path) as port:
        assert "holds no run yet" in json.loads(answer(port, "/run.json").read())["trouble"]
    (tmp_path / "run.json").write_text("{")
    with serving(tmp_path) as port:
        assert "is truncated or no JSON" in json.loads(answer(port, "/run.json").read())["trouble"]
        assert answer(port).status == 200


def test_only_the_loopback_listens() -> None:
    with listening(0) as it:
        assert it.getsockname()[0] == "127.0.0.1"
        taken = it.getsockname()[1]
        with pytest.raises(ValueError, match=rf"--port {taken}: another program listens at 127.0.0.1:{taken}; choose"):
            listening(taken)
    listening(taken).close()  # it is free again
    with pytest.raises(ValueError, match=r"--port 70000: .* cannot be had"):
        listening(70000)


PROBE = """
let blunders = [];
addEventListener("error", event => blunders.push(event.message));
addEventListener("unhandledrejection", event => blunders.push(String(event.reason)));
setTimeout(() => {
  const wide = [...document.body.querySelectorAll("*")].filter(e => e.getBoundingClientRect().right > innerWidth + 1);
  const lines = name => [...at(name).querySelectorAll("polyline, path, rect")].length;
  parent.postMessage(JSON.stringify({
    width: innerWidth, scroll: document.documentElement.scrollWidth, wide: wide.map(e => e.tagName + e.id), blunders,
    paper: getComputedStyle(document.body).backgroundColor, ink: getComputedStyle(document.body).color,
    drawn: ["curve", "map", "policy"].map(lines), crosses: at("map").querySelectorAll(".fail").length,
    texts: Object.fromEntries(["name", "failures", "updates", "rms", "who", "driven"].map(n => [n, at(n).textContent])),
    elsewhere: performance.getEntriesByType("resource").map(r => r.name).filter(n => !n.startsWith(location.origin)),
  }), "*");
}, 6000);
"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome is installed, so the page was not tried in one")
@pytest.mark.parametrize("size", [(390, 844), (1360, 900)], ids=["phone", "desk"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_browser_shows_the_run_and_nothing_sticks_out(
    kept: Path, tmp_path: Path, size: tuple[int, int], dark: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = live._HEADERS["Content-Security-Policy"]
    framed = policy.replace("frame-ancestors 'none'", "frame-ancestors 'self'; frame-src 'self'")
    assert framed != policy
    monkeypatch.setitem(live._HEADERS, "Content-Security-Policy", framed)
    run = rundir.load(kept)
    with listening(0) as it, Server(it, kept) as server:
        script, kind = server.page["/page.js"]
        server.page["/page.js"] = (script + PROBE.encode(), kind)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        options = ("--blink-settings=preferredColorScheme=0",) if dark else ()
        server.page["/frame"] = ((FRAME % ("frame.js", "/", *size)).encode(), "text/html")
        server.page["/frame.js"] = (FRAME_JS.encode(), kind)
        found = shown(f"{live.address(it)}frame", tmp_path, *options)
        server.shutdown()
    assert (found["blunders"], found["elsewhere"], found["console"]) == ([], [], [])
    assert found["width"] == size[0]
    assert found["scroll"] <= size[0], found["wide"]
    assert found["wide"] == []
    texts = found["texts"]
    assert texts["name"] == "default on paper, seed 3"
    assert (texts["failures"], texts["updates"]) == (str(run.counts.failures), str(run.counts.updates))
    assert texts["driven"] == "0.8 of 0.8 min"
    assert found["crosses"] == run.counts.failures > 0
    assert found["drawn"][0] > 10
    assert found["drawn"][2] > 1000
    shades = [sum(map(int, re.findall(r"\d+", found[name])[:3])) for name in ("paper", "ink")]
    assert (shades[0] < 150 and shades[1] > 600) if dark else (shades[0] > 600 and shades[1] < 150)


# ---- readers that are up to no good ---------------------------------------------------------------------------------

RUBBISH = (
    b"",
    b"\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(range(256)),  # TLS
    b"\x00\xff" * 50_000,
    b"GET " + b"/" * 70_000,
    b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 200 + b"\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: \xff\xfe\r\n\r\n",
    b"GET /run.json\r\n",
    b"POST / HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\nx",
)


def test_rubbish_gets_nothing_and_leaves_the_page_as_it_was(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with listening(0) as it, Server(it, tmp_path) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        port = it.getsockname()[1]
        for data in RUBBISH:
            assert b"200 OK" not in raw(port, data), data[:40]
        for _ in range(20):  # gone in the middle of an answer
            link = socket.create_connection(("127.0.0.1", port))
            link.sendall(f"GET /page.js HTTP/1.0\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            link.close()
        assert answer(port).status == 200
        server.shutdown()
        assert all(server._free.acquire(timeout=SLOW) for _ in range(live.AT_ONCE))  # all were answered
    assert capfd.readouterr() == ("", "")  # the terminal is the learner's
    assert caplog.records == []


def test_silent_readers_are_sent_away_so_that_others_are_answered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "PATIENCE", 0.3)
    with serving(tmp_path) as port, contextlib.ExitStack() as open_:
        for k in range(3 * live.AT_ONCE):
            link = open_.enter_context(socket.create_connection(("127.0.0.1", port)))
            with contextlib.suppress(OSError):  # those beyond AT_ONCE are turned away at once
                link.sendall(b"GET / HT" if k % 2 else b"")
        end = time.monotonic() + 20.0  # of patience there is 0.3 s
        while True:
            with contextlib.suppress(OSError, http.client.HTTPException):
                assert answer(port).status == 200
                break
            assert time.monotonic() < end
            time.sleep(0.05)
        assert sum(thread.name.startswith("Thread-") for thread in threading.enumerate()) <= 2 * live.AT_ONCE


# ---- beside a run ---------------------------------------------------------------------------------------------------


COLD = (sys.executable,)


def learning(python: tuple[str, ...], tmp_path: Path, out: str, *more: str) -> subprocess.Popen[str]:
    (tmp_path / "my.toml").write_text(CONFIG)
    words = [*python, "-m", "steerkit", "learn", "--config", "my.toml", "--out", out, "--quiet", *more]
    return subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def port_of(process: subprocess.Popen[str]) -> int:
    assert process.stdout is not None
    found = re.search(r"http://127\.0\.0\.1:(\d+)/", process.stdout.readline())
    assert found
    return int(found[1])


def product(place: Path) -> dict[str, Any]:
    """What a run has learned, bit for bit, without the computing time that it took."""
    counts = rundir.document(place)["counts"] | {"train_seconds": 0.0}
    files: dict[str, Any] = {}
    for file in sorted(place.rglob("*.npz")):
        with np.load(file) as arrays:
            files[str(file.relative_to(place))] = {name: arrays[name].tobytes() for name in arrays.files}
    return {"counts": counts, **files}


def gone(port: int) -> None:
    """Wait until nobody listens there."""
    end = time.monotonic() + 20.0
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=SLOW).close()
        except ConnectionError:
            return
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_run_with_the_page_and_the_worst_of_readers_is_bit_for_bit_the_run_without(
    python: tuple[str, ...], tmp_path: Path
) -> None:
    process = learning(python, tmp_path, "watched", "--live", "--port", "0")
    port = port_of(process)
    hanging = [socket.create_connection(("127.0.0.1", port)) for _ in range(4)]
    for link in hanging:
        link.sendall(b"GET /run.json HT")
    seen: list[dict[str, Any]] = []
    while process.poll() is None:
        with contextlib.suppress(OSError, http.client.HTTPException, ValueError):
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/run.json", timeout=SLOW) as told:
                seen.append(json.load(told))
            raw(port, RUBBISH[len(seen) % len(RUBBISH)])
        time.sleep(0.05)
    output, errors = process.communicate(timeout=SLOW)
    assert process.returncode == 0, errors
    assert errors == ""
    for link in hanging:
        link.close()
    gone(port)  # the server has ended with the run
    assert seen
    alone = learning(python, tmp_path, "alone")
    assert alone.wait(SLOW) == 0
    assert product(tmp_path / "watched") == product(tmp_path / "alone")
    assert "one round of circle" in output


def test_killed_the_one_or_the_other(tmp_path: Path) -> None:
    """The learner's end is the page's; the page's end is nothing to the learner."""
    process = learning(COLD, tmp_path, "killed", "--live", "--port", "0", "--minutes", "600")
    port = port_of(process)
    assert answer(port).status == 200
    times: list[float] = []
    while len(set(times)) < 3:  # the run is seen on its way
        assert process.poll() is None
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/run.json", timeout=SLOW) as answered:
            told = json.load(answered)
        if "t" in told:
            assert str(told["learner"]).startswith(f"process {process.pid} ")
            times.append(told["t"])
        time.sleep(0.05)
    assert times == sorted(times)
    process.kill()
    process.communicate(timeout=SLOW)
    gone(port)
    process = learning(COLD, tmp_path, "run", "--live", "--port", "0", "--minutes", "0.3")
    port = port_of(process)
    (server,) = (int(pid) for pid in os.listdir("/proc") if pid.isdigit() and _parent(pid) == process.pid)
    os.kill(server, signal.SIGKILL)
    output, errors = process.communicate(timeout=SLOW)
    assert (process.returncode, errors) == (0, "")
    assert "one round of circle" in output
    gone(port)


def _parent(pid: str) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return -1


def test_a_port_that_is_taken_is_told_before_the_first_second(python: tuple[str, ...], tmp_path: Path) -> None:
    with listening(0) as it:
        port = str(it.getsockname()[1])
        process = learning(python, tmp_path, "run", "--live", "--port", port)
        _, errors = process.communicate(timeout=SLOW)
    assert process.returncode == 2
    assert errors.startswith(f"steerkit: --port {port}: another program listens at 127.0.0.1:{port}; choose another")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["show", "learn"])
def test_a_page_that_stays_ends_with_ctrl_c(command: str, python: tuple[str, ...], kept: Path, tmp_path: Path) -> None:
    if command == "show":
        words = [*python, "-m", "steerkit", "show", str(kept), "--live", "--port", "0"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    else:
        process = learning(python, tmp_path, "run", "--live", "--port", "0", "--stay", "--minutes", "0.1")
    port = port_of(process)
    if command == "learn":
        assert process.stdout is not None
        while "stays until Ctrl-C" not in process.stdout.readline():
            assert process.poll() is None
    told = json.loads(answer(port, "/run.json").read())
    assert told["learner"] is None
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=SLOW)
    assert (process.returncode, errors) == (0, "")
    gone(port)
