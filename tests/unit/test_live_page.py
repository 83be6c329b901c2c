"""The page of `gelsim live`: moved by its handle and its controls, its recording read back, and a real drag in a browser."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("viser")
from test_baked import flat_scene
from test_lightfield import linear_field
from websockets.sync.client import connect

from gelsim import optics
from gelsim.cli import main as cli
from gelsim.errors import SceneError
from gelsim.live.press import live_press
from gelsim.live.sensor import LiveSensor
from gelsim.optics import bake
from gelsim.scene.definition import Body, Gel, Markers, Press, Scene
from gelsim.scene.layers import load_scene
from gelsim.tables import read_csv
from gelsim.views import live_page
from gelsim.views.live_page import LivePage

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
SCENE = flat_scene(
    gel=Gel(profile="flat", size_mm=(16.0, 16.0)),
    markers=Markers(layout="grid", pitch_mm=1.0),
    object=Body(shape="hemisphere", radius_mm=2.0, height_mm=4.0, rigid=True),
)


@pytest.fixture
def made_up_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of a minute's measurement."""
    for module in (bake, optics):
        monkeypatch.setattr(module, "light_field", lambda *_: linear_field())


@pytest.fixture
def page(made_up_light: None, tmp_path: Path) -> Iterator[LivePage]:
    made = LivePage(SCENE, port=0, record=tmp_path / "hand", device="cpu")
    yield made
    made.close()


def settle(page: LivePage) -> None:
    while page.refresh():
        pass


def test_a_move_is_seen_and_felt(page: LivePage) -> None:
    settle(page)
    picture, height = page._image.image, page._map.image
    assert page.frame.force[2] == 0
    page.handle.position = (0.0, 0.0, -0.5)
    assert page.refresh() and not page.refresh()
    assert page.frame.force[2] < -0.01 and f"{-page.frame.force[2]:.2f} N" in page._force.content
    assert np.abs(page._image.image.astype(int) - picture).max() > 10 and (page._map.image != height).any()
    # The gel in 3D is as deep as the ball.
    assert page._gel.vertices[:, 2].reshape(page._x.shape)[1:-1, 1:-1].min() == pytest.approx(-0.5, abs=0.01)
    page.handle.position = (0.0, 0.0, -2.0)
    settle(page)
    assert "allowed is" in page._told.content and page._gel.vertices[:, 2].reshape(page._x.shape)[1:-1, 1:-1].min() > -0.6
    page._lift()
    settle(page)
    assert page.frame.force[2] == 0 and "frames a second" in page._told.content


def test_a_soft_object_gives(page: LivePage) -> None:
    page._rigid.value = False
    settle(page)  # a soft ball is larger
    assert "2.5 …" in page._told.content and page._rigid.value and page.scene.object.rigid
    page._sizes.value = 3.0
    settle(page)
    page.handle.position = (0.0, 0.0, -0.5)
    settle(page)
    rigid = page.frame.force[2]
    assert not page._shores.visible
    page._rigid.value, page._shores.value = False, 20.0
    settle(page)
    assert (page.scene.object.rigid, page.scene.object.shore_00) == (False, 20.0) and page._shores.visible
    page.handle.position = (0.0, 0.0, -0.5)
    settle(page)
    assert 0.2 * rigid > page.frame.force[2] > 0.95 * rigid
    page._shores.value = 80.0
    settle(page)
    soft, page.handle.position = page.frame.force[2], (0.0, 0.0, -0.5)
    settle(page)
    assert page.frame.force[2] < soft
    page._rigid.value = True
    settle(page)
    page.handle.position = (0.0, 0.0, -0.5)
    settle(page)
    assert page.frame.force[2] == pytest.approx(rigid, rel=1e-6)


def test_controls_make_another_sensor_and_object(page: LivePage) -> None:
    page._shapes.value = "box"
    settle(page)
    assert (page.scene.object.shape, page._sizes.value) == ("box", 10.0)
    page._sizes.value = 3.0
    settle(page)
    assert page.scene.object.width_mm == 3.0 and page.handle.position[2] == live_page.ABOVE[2]
    page._sensors.value = "digit"
    made = page._made

    def slow(scene: Scene) -> LiveSensor:
        page._sizes.value = 2.5  # someone moves the slider meanwhile
        page._made = made
        return made(scene)

    page._made = slow  # type: ignore[method-assign]
    page.refresh()
    assert page.scene.object.width_mm == 3.0 and page.refresh() and page.scene.object.width_mm == 2.5
    page._sizes.value = 3.0
    settle(page)
    assert page.scene.gel == load_preset("digit").gel and page.scene.object.width_mm == 3.0
    page._shapes.value, page._sizes.value = "hemisphere", 2.0
    settle(page)
    page._sizes.value = 60.0  # more than a radius may be
    page.refresh()
    assert "radius_mm" in page._told.content and page._sizes.value == page.scene.object.radius_mm == 2.0


def load_preset(name: str) -> Any:
    from gelsim.scene.layers import build_scene

    return build_scene({"sensor": {"preset": name}})


def test_other_light_is_drawn_at_rest(page: LivePage, monkeypatch: pytest.MonkeyPatch) -> None:
    page.handle.position = (0.0, 0.0, -0.5)
    page._lights.value = "direct"
    assert page.refresh() and not page.refresh() and page._light == "baked"  # it moved just now
    monkeypatch.setattr(live_page, "REST_S", 0.0)
    assert page.refresh() and not page.refresh() and "direct" in page._image.label
    assert (page._image.image != page.frame.image).any()
    page._lights.value = "baked"
    assert page.refresh() and (page._image.image == page.frame.image).all()


def test_a_recording_is_walked_again(page: LivePage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By `press.path_csv`, to the same force: places are written to 1e-6 mm."""
    # States equally spaced in time lie between moves: how long these took is where friction looks, which is worth 0.1 % of the force.
    start, ticks = time.monotonic(), itertools.count(1)
    monkeypatch.setattr(live_page, "time", SimpleNamespace(**vars(time) | {"monotonic": lambda: start + 0.1 * next(ticks)}))
    turned = (np.cos(0.05), 0.0, np.sin(0.05), 0.0)
    for x, z in ((0.0, 0.2), (0.0, -0.1), (0.0, -0.4), (0.1, -0.5)):
        page.handle.position, page.handle.wxyz = (x, 0.0, z), turned
        settle(page)
    force, picture = page.frame.force, page.frame.image
    page._sizes.value = 3.0
    settle(page)
    take = tmp_path / "hand" / "0000"
    assert not (tmp_path / "hand" / "0001").exists()
    page.handle.position = (0.0, 0.0, 0.9)
    settle(page)
    assert [path.name for path in sorted((tmp_path / "hand").iterdir())] == ["0000", "0001"]
    _, felt = read_csv(take / "forces.csv")
    frames = sorted((take / "frames").glob("*.png"))
    assert len(frames) == len(felt) == 5 and [float(felt[-1][f"{axis}_n"]) for axis in "xyz"] == pytest.approx(list(force), rel=1e-5)
    assert (np.asarray(Image.open(frames[-1])) == picture).all()
    _, markers = read_csv(take / "markers.csv")
    assert {row["frame"] for row in markers} == set("01234")
    scene = load_scene(take / "scene.toml")
    assert scene.object == SCENE.object
    walked = live_press(scene.replace(press=Press(path_csv=str(take / "motion.csv"), frames=5)))
    assert walked.force[-1] == pytest.approx(force, rel=2e-3, abs=1e-3 * np.abs(force).max())


def test_what_cannot_be_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").touch()
    assert cli.main(["live", "--record", str(tmp_path / "full")]) == 2 and "holds files already" in capsys.readouterr().err
    assert cli.main(["live", "--port", "99999"]) == 2 and "allowed is 0 … 65535" in capsys.readouterr().err
    assert cli.main(["live", "--shore", "30"]) == 2 and "rigid" in capsys.readouterr().err
    soft = tmp_path / "soft.toml"
    soft.write_text("[object]\nprony_g = [0.2]\nprony_tau_s = [1.0]\n")
    assert cli.main(["live", "--scene", str(soft)]) == 2 and "object.prony_g" in capsys.readouterr().err
    assert cli.main(["live", "--video-device", "77"]) == 2 and "--video-device 77" in capsys.readouterr().err
    monkeypatch.delitem(sys.modules, "gelsim.views.live_page")
    monkeypatch.setitem(sys.modules, "viser", None)
    assert cli.main(["live"]) == 2 and 'pip install "gelsim[live]"' in capsys.readouterr().err


def test_a_camera_is_shown_beside_it(made_up_light: None, monkeypatch: pytest.MonkeyPatch) -> None:
    import imageio.v2

    class Reader:
        def iter_data(self) -> Iterator[np.ndarray]:
            yield np.full((6, 8, 3), 90, np.uint8)

    monkeypatch.setattr(imageio.v2, "get_reader", lambda name: {"<video3>": Reader()}[name])
    page = LivePage(SCENE, port=0, video_device=3, device="cpu")
    try:
        for _ in range(100):
            page.refresh()
            if page._real.image.shape == (6, 8, 3):
                break
            time.sleep(0.01)
        assert (page._real.image == 90).all()
    finally:
        page.close()
    with pytest.raises(SceneError, match="no such camera"):
        LivePage(SCENE, port=0, video_device=4, device="cpu")


class Browser:
    """Chromium, told what to do by its DevTools protocol."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM is not None
        flags = ["--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--window-size=1200,560", "--remote-debugging-port=0"]
        command = [CHROMIUM, *flags, f"--user-data-dir={folder}", "about:blank"]
        self._child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self._child.stderr is not None
        port = next(found[1] for line in self._child.stderr if (found := re.search(r"ws://127\.0\.0\.1:(\d+)/", line)))
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            (tab,) = (each for each in json.load(answer) if each["type"] == "page")
        self._socket, self._number = connect(tab["webSocketDebuggerUrl"], max_size=None), 0

    def __call__(self, method: str, **parameters: object) -> Any:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv(timeout=120))).get("id") != self._number:
            pass
        return answer["result"]

    def value(self, script: str) -> Any:
        return self("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def drag(self, start: np.ndarray, end: np.ndarray) -> None:
        def mouse(kind: str, at: np.ndarray, held: bool) -> None:
            button = {"button": "left", "buttons": 1} if held else {"button": "left" if kind == "mouseReleased" else "none", "buttons": 0}
            self("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], clickCount=1, **button)

        mouse("mouseMoved", start, False)
        mouse("mouseMoved", start + 1, False)
        mouse("mousePressed", start, True)
        for share in np.linspace(0, 1, 9):
            mouse("mouseMoved", start + share * (end - start), True)
        mouse("mouseReleased", end, False)

    def close(self) -> None:
        self._socket.close()
        self._child.terminate()
        self._child.wait()
        assert self._child.stderr is not None
        self._child.stderr.close()


def on_screen(page: LivePage, point: tuple[float, float, float], canvas: dict[str, float]) -> np.ndarray:
    """Where a point of the scene [mm] is seen [px], by the camera that the page begins with."""
    camera = page._server.initial_camera
    eye = camera.position
    ahead = (camera.look_at - eye) / np.linalg.norm(camera.look_at - eye)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    away = point - eye
    scale = canvas["height"] / 2 / np.tan(camera.fov / 2) / (away @ ahead)
    middle = np.array([canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2])
    return middle + scale * np.array([away @ right, -(away @ np.cross(right, ahead))])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_drag_in_a_browser_changes_the_picture(page: LivePage, tmp_path: Path) -> None:
    """The tip of the arrow along z is taken and drawn down by 1.5 mm: the ball then is 0.5 mm deep."""
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            if not page.refresh():
                time.sleep(0.01)

    thread = threading.Thread(target=serve)
    thread.start()
    browser = Browser(tmp_path / "profile")
    shown = "[...document.querySelectorAll('img')].map(each => each.src).join(' ')"

    def wait(script: str, wanted: Any = lambda value: value) -> Any:
        until = time.monotonic() + 90
        while not wanted(found := browser.value(script)):
            assert time.monotonic() < until, script
            time.sleep(0.2)
        return found

    try:
        browser("Page.navigate", url=page.address)
        wait("document.body.innerText.includes('frames a second') && document.querySelectorAll('img').length >= 2")
        canvas = json.loads(
            wait("JSON.stringify(document.querySelector('canvas')?.getBoundingClientRect() ?? null)", lambda it: it != "null")
        )
        time.sleep(3)  # until it is drawn
        before = browser.value(shown)
        tip = page.handle.position[2] + 7.6
        browser.drag(on_screen(page, (0, 0, tip), canvas), on_screen(page, (0, 0, tip - 1.5), canvas))
        assert wait(shown, lambda now: now != before)
        wait(f"document.body.innerText.includes('{-page.frame.force[2]:.2f} N')")
    finally:
        browser.close()
        ended.set()
        thread.join()
    assert page.handle.position == pytest.approx((0.0, 0.0, -0.5), abs=0.2) and page.frame.force[2] < -0.01
