"""`gelsim live`: a local page on which a person presses an object into the gel with the mouse, and sees what the sensor does.

The object hangs on transform controls over the gel in 3D. Each time it has moved, `LiveSensor.step` answers, and picture, height, markers
and force are shown together; sensor, shape, size, hardness and light are chosen beside them. One loop does it all (`LivePage.refresh`): it
reads what controls say now, so of a fast drag it takes the newest pose and leaves out those in between; friction sees a straight way.

Pictures are baked while the object moves; of light "direct" and "path" one is traced when it rests. A recording has a folder for each
sensor and object, with frames and markers as `gelsim render` has them and the motion as `press.path_csv` reads it.

Left out: how a soft object looks as it gives, several objects, and what docs/live.md says of the baked gel. The page is served to this
machine only (viser).
"""

from __future__ import annotations

import csv
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation
from viser import uplot

from gelsim import optics
from gelsim.data.episodes import field_seen
from gelsim.errors import GelsimError, SceneError
from gelsim.live.sensor import LiveFrame, LiveSensor, check_scene
from gelsim.membrane.surface import grid_faces, moved_membrane
from gelsim.pipeline import outputs
from gelsim.scene import materials
from gelsim.scene.definition import Body, Press, Scene
from gelsim.scene.layers import PRESET_SECTIONS, build_scene, preset_names
from gelsim.scene.measured_path import COLUMNS
from gelsim.scene.shape_table import SHAPES
from gelsim.shape import shapes
from gelsim.units import MM, MM_PER_M

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Progress = Callable[[str, int, int], None]

HOST = "127.0.0.1"
PORT, LAST_PORT = 8080, 65535
ABOVE = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Pose of the object at first and when it is lifted: mm, and a quaternion w, x, y, z."""
STEP_S = 1 / 30
"""Which the elastic gel does not look at."""
REST_S = 0.3
"""Without motion after which a picture is traced."""
IDLE_S = 0.01
"""Between two looks at a page on which nothing happened."""
SIZES_MM, SHORES = (1.0, 25.0), (5.0, 95.0)
"""Ends of the sliders."""
ARROWS = 5
"""Marker arrows are drawn so many times as long as the markers moved."""
LEAST_SPAN = 0.05
"""Of the height's colours [mm]: what is less looks flat."""
RATE_OF = 30
"""Steps whose rate is told."""
CURVE = 300
"""Steps that the force's curve shows."""
GEL, WINDOW, OBJECT = (120, 124, 132), (150, 190, 210), (214, 128, 74)


class LivePage:
    """The page and its sensor. Whoever makes it calls `refresh` again and again, or `run`."""

    def __init__(
        self,
        scene: Scene,
        *,
        port: int = PORT,
        record: Path | None = None,
        video_device: int | None = None,
        device: str = "auto",
        progress: Progress | None = None,
    ) -> None:
        """Makes the sensor, then serves the page.

        Args:
            scene: As for `LiveSensor`: sensor, friction and the first object.
            port: Of the page; the next that is free where it is taken; 0 is any.
            record: A folder that is not there yet, or empty, for what is done on the page.
            video_device: Number of a camera of this machine whose picture is shown too.
            device: "auto" | "cpu" | "cuda", of the pictures.
            progress: Told how far the measurement of a sensor's light is.
        Raises:
            SceneError: What no live sensor has, a folder that holds files, or no such camera or port.
        """
        if not 0 <= port <= LAST_PORT:
            raise SceneError(f"--port {port}: allowed is 0 … {LAST_PORT}; 0 is any that is free")
        self.recording = None if record is None else Recording(record)
        self._camera = None if video_device is None else _Camera(video_device)
        self._given, self._device, self._progress = scene, device, progress
        self.scene, self.sensor = scene, self._made(scene)
        self.frame: LiveFrame
        """The last answer."""
        self._server = viser.ViserServer(HOST, port, label="gelsim live", verbose=False)
        self._lay_out()
        self._asked = self._choices
        self._begin()

    @property
    def address(self) -> str:
        """Of the page, http://…"""
        return f"http://{HOST}:{self._server.get_port()}"

    def run(self) -> None:
        """Serves until it is interrupted."""
        while True:
            if not self.refresh():
                time.sleep(IDLE_S)

    def close(self) -> None:
        """Ends page and recording."""
        self._server.stop()
        if self.recording:
            self.recording.close()

    def refresh(self) -> bool:
        """Looks once at what the controls say, and shows what changed; returns whether anything did."""
        if self._camera and (seen := self._camera.latest()) is not None:
            self._real.image = seen
        if self._choices != self._asked:
            self._change(*self._choices)
        elif not np.array_equal(self._placed, self._pose):
            self._move(self._placed)
        elif self._lights.value != self._light and time.monotonic() - self._moved > REST_S:
            self._trace(self._lights.value)
        else:
            return False
        return True

    # ---- what happens ----

    def _made(self, scene: Scene) -> LiveSensor:
        scene = scene.replace(render=replace(scene.render, mode="baked"))
        check_scene(scene, "a live sensor", "gelsim.press")  # before minutes go into the light
        optics.light_field(scene, optics.choose_variant(self._device), self._progress)
        return LiveSensor(scene, device=self._device)

    def _begin(self) -> None:
        """A gel at rest, and the object above it."""
        sensor, gel = self.sensor, self.scene.gel
        columns, rows = self._places()
        self._shown = np.ix_(rows, columns)
        x, y = (np.pad(along * MM_PER_M, 1, mode="edge") for along in (sensor.x, sensor.y))  # one more cell all around: the gel's sides
        self._x, self._y = np.meshgrid(x, y)
        self._server.scene.add_box(
            "/window", WINDOW, (*gel.size_mm, 1.0), opacity=0.5, position=(0, 0, -gel.thickness_mm - 0.5), cast_shadow=False
        )
        surface = shapes.object_surface(self.scene.object, edge_length=math.inf)
        self._server.scene.add_mesh_simple(
            "/object/shape", surface.vertices * MM_PER_M, surface.faces, color=OBJECT, opacity=0.5, flat_shading=True, side="double"
        )
        still = sensor.step([*ABOVE[:3] * MM, *ABOVE[3:]], STEP_S)
        self._rest = still.height, still.marker_pixels
        self._gel = self._server.scene.add_mesh_simple("/gel", self._points(still.height), grid_faces(*self._x.shape), color=GEL)
        self._start, self._curve, self._took = time.monotonic(), deque(maxlen=CURVE), deque(maxlen=RATE_OF)
        if self.recording:
            self.recording.begin(self.scene)
        self._lift()
        self._move(self._placed)

    def _lift(self) -> None:
        self.handle.position, self.handle.wxyz = ABOVE[:3], ABOVE[3:]

    @property
    def _choices(self) -> tuple[str, str, float, bool, float]:
        """Sensor, shape, size, whether it is rigid, and hardness that the controls name."""
        return self._sensors.value, self._shapes.value, self._sizes.value, self._rigid.value, self._shores.value

    @property
    def _placed(self) -> Array:
        """Where the object hangs: mm, and a quaternion w, x, y, z."""
        return np.array([*self.handle.position, *self.handle.wxyz])

    def _change(self, sensor: str, shape: str, size: float, rigid: bool, shore: float) -> None:
        """Another sensor or object; where there is none such, the page says why and stays as it was."""
        given = self._given
        body = given.object if shape == given.object.shape else Body(shape=shape, rigid=rigid, height_mm=given.object.height_mm)
        other = shape != self._asked[1]
        if other:
            size = _size(body)
        if rigid:
            body = replace(body, rigid=True)
        elif body.rigid or shape != given.object.shape or shore != _shore(given.object):
            body = replace(body, rigid=False, shore_00=shore, shore_a=None, youngs_modulus_kpa=None, modulus_scale=1.0)
        try:
            of_sensor = given if sensor == given.sensor.preset else build_scene({"sensor": {"preset": sensor}})
            parts = {name: getattr(of_sensor, name) for name in ("sensor", *PRESET_SECTIONS)}
            scene = self.scene.replace(object=_sized(body, size), **parts)
            self._say("Making it ready; a light that was not measured before takes some seconds …")
            self.sensor = self._made(scene)
        except GelsimError as error:
            self._sensors.value, self._shapes.value, self._sizes.value, self._rigid.value, self._shores.value = self._asked
            self._say(str(error))
            return
        self.scene, self._asked = scene, (sensor, shape, size, rigid, shore)  # a control that was moved meanwhile differs, and is next
        self._shores.visible = not rigid
        if other:
            self._sizes.value, self._sizes.visible = size, shape != "mesh"
        self._begin()

    def _move(self, pose: Array) -> None:
        """Object to a pose, mm and quaternion; one that the sensor refuses is said and leaves no trace."""
        begin = time.perf_counter()
        self._pose, self._moved = pose, time.monotonic()
        try:
            frame = self.sensor.step([*pose[:3] * MM, *pose[3:]], STEP_S)
        except GelsimError as error:
            self._say(str(error))
            return
        self.frame, self._light = frame, "baked"
        if self.recording:
            self.recording.add(self._moved, pose, frame)
        self._show()
        self._took.append(time.perf_counter() - begin)
        self._say(f"{len(self._took) / sum(self._took):.0f} frames a second")

    def _trace(self, mode: str) -> None:
        """The picture at this pose by another light."""
        self._light = mode
        if mode == "baked":
            picture = self.frame.image
        else:
            scene = self.scene.replace(render=replace(self.scene.render, mode=mode))
            begin = time.perf_counter()
            (drawn,) = optics.render_frames(scene, [moved_membrane(scene, self.sensor.displaced)], device=self._device)
            picture = drawn.image
            self._say(f"traced in {time.perf_counter() - begin:.1f} s")
        self._show_picture(picture)

    # ---- what is seen ----

    def _lay_out(self) -> None:
        """Controls to the right, what the sensor sees to the left, between them gel and object."""
        server, given = self._server, self._given
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(320)
        server.gui.set_panel_label("gelsim live")
        server.scene.set_up_direction("+z")
        server.initial_camera.position, server.initial_camera.look_at = (15.0, -44.0, 24.0), (0.0, 0.0, 4.0)
        server.initial_camera.fov = math.radians(45)
        server.scene.configure_default_lights(False)
        server.scene.add_light_ambient("/light/all", intensity=0.8)
        server.scene.add_light_directional("/light/low", position=(-30.0, -10.0, 12.0), intensity=3.0)  # so low that a dent shows
        gui = server.gui
        self._force = gui.add_markdown("")
        self._plot = gui.add_uplot(
            (np.zeros(1), np.zeros(1), np.zeros(1)),
            (uplot.Series(), uplot.Series(stroke="#1f6fb4"), uplot.Series(stroke="#d6804a")),
            title="force [N]: normal blue, along the gel orange",
            height=170,
            scales={"x": uplot.Scale(time=False)},
            legend=uplot.Legend(show=False),
        )
        presets = list(dict.fromkeys([given.sensor.preset, *preset_names()]))
        names = list(dict.fromkeys([given.object.shape, *(name for name in SHAPES if name != "mesh")]))
        self._sensors = gui.add_dropdown("sensor", presets)
        self._shapes = gui.add_dropdown("shape", names)
        size = _size(given.object)
        self._sizes = gui.add_slider("size [mm]", min(SIZES_MM[0], size), max(SIZES_MM[1], size), 0.25, size, hint="radius, or width")
        self._sizes.visible = not given.object.mesh
        self._rigid = gui.add_checkbox("rigid", given.object.rigid)
        self._shores = gui.add_slider("Shore 00", *SHORES, 1.0, _shore(given.object))
        self._shores.visible = not given.object.rigid
        self._lights = gui.add_dropdown("light", ["baked", "direct", "path"], hint="direct and path: traced when the object rests")
        gui.add_button("Lift the object").on_click(lambda _: self._lift())
        self._told = gui.add_markdown("")
        panel = gui.add_panel()
        blank = np.zeros((3, 4, 3), np.uint8)
        with panel.add_tab("what the sensor sees"):
            self._image = gui.add_image(blank, format="jpeg", jpeg_quality=90)
            self._map = gui.add_image(blank, format="jpeg", jpeg_quality=90)
            if self._camera:
                self._real = gui.add_image(blank, label="camera", format="jpeg", jpeg_quality=90)
        panel.dock_left()
        panel.set_width(440)
        self.handle = server.scene.add_transform_controls("/object", 9.0, depth_test=False)
        """What the object hangs on, in mm."""

    def _show(self) -> None:
        frame, server = self.frame, self._server
        time_s = time.monotonic() - self._start
        normal, along = 0.0 - float(frame.force[2]), float(np.hypot(*frame.force[:2]))
        self._curve.append((time_s, normal, along))
        cell = np.prod([places[1] - places[0] for places in (self.sensor.x, self.sensor.y)]) * MM_PER_M**2
        with server.atomic():
            self._gel.vertices = self._points(frame.height)
            self._show_picture(frame.image)
            self._show_map()
            self._force.content = (
                f"## {normal:.2f} N normal force\n**along the gel** {along:.2f} N  \n"
                f"**torque** {', '.join(f'{value * 1e3:z.1f}' for value in frame.torque)} N mm  \n"
                f"**contact** {frame.contact.sum() * cell:.1f} mm²"
            )
            self._plot.data = tuple(np.array(self._curve, np.float64).T.copy())

    def _points(self, height: NDArray[np.float32]) -> NDArray[np.float32]:
        """Corners of the gel's face and of its sides' lower ends [mm], (M, 3)."""
        z = np.pad(height * MM_PER_M, 1, constant_values=-self.scene.gel.thickness_mm)
        return np.stack([self._x, self._y, z], axis=-1).reshape(-1, 3).astype(np.float32)

    def _show_picture(self, picture: Picture | None) -> None:
        assert picture is not None
        self._image.image, self._image.label = picture, f"picture, light {self._light}"

    def _show_map(self) -> None:
        """Height over the gel at rest in the picture's field, and marker arrows on it."""
        frame = self.frame
        rest, markers = self._rest
        raised = (frame.height - rest)[self._shown] * MM_PER_M
        low, high = float(raised.min()), float(raised.max())
        floor = min(low, high - LEAST_SPAN)
        share = (raised - floor) / (high - floor)
        size = self.scene.render.resolution
        picture = Image.fromarray(_COLOURS[np.rint(255 * share).astype(np.uint8)]).resize(size, Image.Resampling.BILINEAR)
        pen = ImageDraw.Draw(picture)
        for start, moved in zip(markers, frame.marker_pixels - markers, strict=True):
            if np.isfinite(start).all() and np.isfinite(moved).all():
                pen.line([*start, *(start + ARROWS * moved)], fill="white", width=2)
                pen.ellipse([*(start - 1.5), *(start + 1.5)], fill="white")
        self._map.image = np.asarray(picture)
        self._map.label = f"height over rest, {low:.2f} to {high:.2f} mm; marker motion, {ARROWS} times"

    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Columns and rows of the sensor's grid under the picture's field."""
        columns, rows = (
            np.flatnonzero(np.abs(places * MM_PER_M - middle) <= seen / 2)
            for places, seen, middle in zip(
                (self.sensor.x, self.sensor.y), field_seen(self.scene), self.scene.camera.offset_mm, strict=True
            )
        )
        return columns, rows

    def _say(self, text: str) -> None:
        self._told.content = text
        self._server.flush()


def _sized(body: Body, size: float) -> Body:
    """The object with the slider's size [mm]: its radius, or its width where it has none; a file has the size that it has."""
    if body.mesh:
        return body
    if SHAPES[body.shape].has_radius:
        return replace(body, radius_mm=size, height_mm=max(body.height_mm, 2 * size))
    return replace(body, width_mm=size)


def _size(body: Body) -> float:
    """What the slider says of an object [mm]."""
    return body.radius_mm if SHAPES[body.shape].has_radius else body.width_mm or SHAPES[body.shape].width_mm


def _shore(body: Body) -> float:
    """What the slider says of an object's hardness, in whole Shore 00; of a rigid one, of that which it would have."""
    softest, hardest = (materials.modulus_from_shore_00(shore) for shore in SHORES)
    modulus = min(max(materials.youngs_modulus(replace(body, rigid=False)), softest), hardest)
    return float(round(materials.shore_00_from_modulus(modulus)))


def _colours() -> Picture:
    import matplotlib

    return (matplotlib.colormaps["viridis"](np.linspace(0, 1, 256))[:, :3] * 255).astype(np.uint8)


_COLOURS = _colours()


class Recording:
    """What was done, in folders 0000, 0001, … of one sensor and object each, written as it happens.

    scene.toml, frames/NNNN.png, markers.csv as of `gelsim render`; motion.csv as `press.path_csv` reads it; forces.csv with frame, t_s,
    force on the gel [N] and torque about the gel's origin [N m].
    """

    def __init__(self, folder: Path) -> None:
        """Raises SceneError where the folder holds files."""
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise SceneError(f"--record {folder}: holds files already; give another folder")
        self.folder, self.frames = folder, 0
        self._takes, self._files = 0, []
        self._first: tuple[float, Array, LiveFrame] | None = None

    def begin(self, scene: Scene) -> None:
        """The next frames are of this sensor and object."""
        self.close()
        self._scene, self._first = scene, None

    def add(self, moment: float, pose: Array, frame: LiveFrame) -> None:
        """One answer: at a monotonic time [s], a pose [mm, quaternion w, x, y, z]. The first is kept until there is a motion."""
        if self._first is None:
            self._first = moment, pose, frame
            return
        if not self._files:
            self._open()
            self._write(*self._first)
        self._write(moment, pose, frame)

    def _write(self, moment: float, pose: Array, frame: LiveFrame) -> None:
        number, time_s = self._number, f"{moment - self._began:.4f}"
        assert frame.image is not None
        outputs.write_image(self._take / "frames" / f"{number:04d}.png", frame.image)
        turn = Rotation.from_quat(np.roll(pose[3:], -1)).as_euler("xyz", degrees=True)
        motion, forces, markers = self._tables
        motion.writerow([time_s, *(f"{value:.6f}" for value in (*pose[:3], *turn))])
        forces.writerow([number, time_s, *(f"{value:.6g}" for value in (*frame.force, *frame.torque))])
        markers.writerows(outputs.marker_rows(number, frame.marker_pixels))
        for file in self._files:
            file.flush()
        self._number += 1
        self.frames += 1

    def close(self) -> None:
        """Ends the folder of this sensor and object."""
        for file in self._files:
            file.close()
        self._files = []

    def _open(self) -> None:
        assert self._first is not None
        self._take = self.folder / f"{self._takes:04d}"
        self._takes, self._number, self._began = self._takes + 1, 0, self._first[0]
        (self._take / "frames").mkdir(parents=True)
        outputs.write_scene(self._take / "scene.toml", self._scene.replace(press=Press()))
        heads = {
            "motion.csv": COLUMNS,
            "forces.csv": ("frame", "t_s", "x_n", "y_n", "z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm"),
            "markers.csv": outputs.MARKER_COLUMNS,
        }
        self._files = [(self._take / name).open("w", newline="", encoding="utf-8") for name in heads]
        self._tables: list[Any] = [csv.writer(file) for file in self._files]
        for table, head in zip(self._tables, heads.values(), strict=True):
            table.writerow(head)


class _Camera:
    """A camera of this machine, read by a thread of its own."""

    def __init__(self, number: int) -> None:
        import imageio.v2

        try:
            self._reader = imageio.v2.get_reader(f"<video{number}>")
        except Exception as error:  # imageio has no error of its own for it
            raise SceneError(f"--video-device {number}: no such camera ({str(error).partition(chr(10))[0]})") from None
        self._fresh: deque[Picture] = deque(maxlen=1)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for picture in self._reader.iter_data():
            self._fresh.append(np.asarray(picture))

    def latest(self) -> Picture | None:
        """8-bit sRGB, (H, W, 3); None where none came since."""
        return self._fresh.pop() if self._fresh else None
