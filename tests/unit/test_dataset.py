"""The dataset on disk: what is written is read again, and what is damaged or hostile is one clear error."""

from __future__ import annotations

import io
import json
import pickle
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gelsim.data import episodes as dataset
from gelsim.data.episodes import Survey, episode_file, gel_facts, load_dataset, read_episode, survey, write_episode, write_meta, write_tar
from gelsim.errors import DatasetError
from gelsim.results import Episode
from gelsim.scene import materials
from gelsim.scene.definition import Gel
from gelsim.views.dataset_sheet import dataset_facts, draw_dataset
from learn.config import InputConfig
from learn.recordings import record_episode

GEL: dict[str, Any] = {"thickness_mm": 2.4, "edge_thickness_mm": 1.0, "shore_00": 17.0}


def make(index: int = 0, count: int = 3, **fields: Any) -> Episode:
    rng = np.random.default_rng(index)
    row = {
        "index": index, "object": f"ball-{index}", "group": 1, "shape": "hemisphere", "radius_mm": 5.0, "shore_00": 30.0, "rigid": False,
        "motion": "human", "domain": "sim", "frames": count, "peak_force_n": 4.2, "mechanics": f"m{index}", "sensor": "fingertip2017",
        "file": episode_file(index),
    }  # fmt: skip
    pictures = rng.integers(0, 256, (count + 1, 12, 16, 3), np.uint8)
    return Episode(
        pictures[1:], pictures[0], np.arange(count) / 30, np.full(count, np.nan), np.full((count, 3), np.nan),
        rng.integers(0, 96, (count, 2, 2)) / 8, row | fields, noise=rng.uniform(0, 1, (3, 3)),
    )  # fmt: skip


def store(folder: Path, count: int = 3) -> Path:
    for index in range(count):
        write_episode(folder, make(index), {"scene.toml": b"seed = 0\n"})
    write_meta(folder, {"domain": "sim", "fps": 30}, survey(folder), [], {"train": [0, 2], "novel_shape": [1]})
    return folder


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    data = load_dataset(store(tmp_path))
    assert len(data) == 3 and data.splits == {"train": [0, 2], "novel_shape": [1]} and data.info["schema"] == 1
    for index, read in enumerate(data):
        made = make(index)
        assert read.row == made.row == data.rows[index]
        for name in ("frames", "background", "time", "approach", "force", "marker_pixels", "noise"):
            np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
    assert data.member(0, "scene.toml") == b"seed = 0\n"


@pytest.mark.parametrize(
    ("gel", "said"),
    [
        (None, "expected a table"),
        ({"thickness_mm": 2.4}, "expected a table of thickness_mm, edge_thickness_mm, shore_00"),
        (GEL | {"maker": "me"}, "expected a table"),
        (GEL | {"thickness_mm": 0.0}, r"gel.thickness_mm = 0.0: allowed is 0.5 … 20 mm"),
        (GEL | {"thickness_mm": float("nan")}, "gel.thickness_mm = nan"),
        (GEL | {"thickness_mm": None}, "gel.thickness_mm = None"),
        (GEL | {"edge_thickness_mm": float("inf")}, "gel.edge_thickness_mm = inf"),
        (GEL | {"edge_thickness_mm": True}, "gel.edge_thickness_mm = True"),
        (GEL | {"shore_00": -17.0}, "gel.shore_00 = -17.0: allowed is 1 … 99$"),
        (GEL | {"shore_00": "17"}, "gel.shore_00 = '17'"),
    ],
)
def test_a_row_tells_a_possible_gel_or_none(gel: Any, said: str, tmp_path: Path) -> None:
    for known in (GEL, GEL | {"shore_00": None}):
        assert read_episode(write_episode(tmp_path, make(gel=known))).row["gel"] == known
    with pytest.raises(DatasetError, match=said):
        write_episode(tmp_path, make(gel=gel))


def test_what_a_row_tells_of_a_gel() -> None:
    assert gel_facts(Gel()) == {"thickness_mm": 2.4, "edge_thickness_mm": 1.0, "shore_00": 17.0}
    # A flat gel is as thick at its edge; what a reading means (the scale) is not what it is.
    assert gel_facts(Gel(profile="flat", shore_00=30.0, modulus_scale=0.5)) == {
        "thickness_mm": 2.4,
        "edge_thickness_mm": 2.4,
        "shore_00": 30.0,
    }
    by_modulus = gel_facts(Gel(youngs_modulus_kpa=materials.modulus_from_shore_00(40.0) / 1e3, modulus_scale=0.5))["shore_00"]
    assert by_modulus == pytest.approx(40.0, abs=1e-9)
    assert gel_facts(Gel(shore_a=45.0))["shore_00"] == pytest.approx(86.7, abs=0.05)  # where the scales meet (gelsim/scene/materials.py)
    assert gel_facts(Gel(youngs_modulus_kpa=1.0))["shore_00"] is None


def still(count: int = 6) -> Episode:
    """An episode whose first two frames are the no-contact frame, and whose last three are equal."""
    made = make(count=count)
    frames = made.frames.copy()
    frames[:2], frames[-3:] = made.background, made.frames[-1]
    return replace(made, frames=frames)


def test_equal_pictures_are_kept_once(tmp_path: Path) -> None:
    made = still()
    path = write_episode(tmp_path, made)
    with tarfile.open(path) as tar:
        links = {member.name: member.linkname for member in tar if member.islnk()}
    first, last = "background.webp", "frames/0003.webp"
    assert links == {"frames/0000.webp": first, "frames/0001.webp": first, "frames/0004.webp": last, "frames/0005.webp": last}
    np.testing.assert_array_equal(read_episode(path).frames, made.frames)
    # Any other reader of tars sees the same files.
    with tarfile.open(path) as tar:
        one, other = tar.extractfile("frames/0005.webp"), tar.extractfile(last)
        assert one is not None and other is not None and one.read() == other.read() != b""
        # WebDataset's readers take each regular file as a sample of its own and pass over links: the row says how many frames there are.
        seen = [member.name for member in tar if member.isreg() and member.name.startswith("frames/")]
        assert seen == ["frames/0002.webp", last] and made.row["frames"] == 6
    # The sums count each frame: exactly, for they are whole numbers.
    sums = survey(tmp_path).sums[0]
    for name, values in (("levels", made.frames), ("change", made.frames.astype(np.int64) - made.background)):
        flat = values.reshape(-1, 3).astype(np.int64)
        assert sums[name] == [flat.sum(axis=0).tolist(), (flat**2).sum(axis=0).tolist()]


def dark(index: int = 0) -> Episode:
    made = make(index, pictures=False)
    return replace(made, frames=np.zeros((3, 0, 0, 3), np.uint8), background=np.zeros((0, 0, 3), np.uint8))


def test_an_episode_without_light_keeps_its_labels(tmp_path: Path) -> None:
    made = dark()
    path = write_episode(tmp_path, made, {"mechanics.npz": b"motion"})
    read = read_episode(path)
    assert read.frames.shape == (3, 0, 0, 3) and read.row == made.row
    np.testing.assert_array_equal(read.marker_pixels, made.marker_pixels)
    write_meta(tmp_path, {"domain": "sim", "fps": 30, "resolution": [0, 0]}, survey(tmp_path), [], {"train": [0]})
    data = load_dataset(tmp_path)
    assert data.stats["pixels"] == 0 and dataset_facts(data)["frames"] == 3
    draw_dataset(tmp_path / "sheet.png", data)
    with pytest.raises(DatasetError, match="episode 0: has no pictures"):
        record_episode(read, InputConfig())
    # Pictures that should be there and are not are damage, and a row that does not say what is there is no episode.
    rewritten(path, "row.json", json.dumps({"row": {**made.row, "pictures": True}, "sums": {}}).encode())
    with pytest.raises(DatasetError, match="holds 0 frames"):
        read_episode(path)
    for wrong in (replace(dark(), row=make().row), replace(make(), row=dark().row)):
        with pytest.raises(DatasetError, match="in its row"):
            write_episode(tmp_path, wrong)


@pytest.mark.parametrize("target", ["frames/0005.webp", "../../etc/passwd", "row.json"])
def test_a_link_to_no_picture_is_refused(tmp_path: Path, target: str) -> None:
    """To itself, out of the archive, to something else."""
    path = write_episode(tmp_path, still())
    with tarfile.open(path) as tar:
        members = [(member, tar.extractfile(member)) for member in tar]
        with tarfile.open(tmp_path / "other.tar", "w") as other:
            for member, file in members:
                if member.name == "frames/0005.webp":
                    member.linkname = target
                other.addfile(member, file if member.isreg() else None)
    with pytest.raises(DatasetError, match="is missing|is damaged"):
        read_episode(tmp_path / "other.tar")


def test_png_is_read_too(tmp_path: Path) -> None:
    from PIL import Image

    made = make()
    path = write_episode(tmp_path, made)
    with tarfile.open(path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    for name in [name for name in files if name.endswith(".webp")]:
        buffer = io.BytesIO()
        Image.open(io.BytesIO(files.pop(name))).save(buffer, format="PNG")
        files[name.replace(".webp", ".png")] = buffer.getvalue()
    write_tar(path, files)
    np.testing.assert_array_equal(read_episode(path).frames, made.frames)


def test_statistics_are_those_of_the_train_split(tmp_path: Path) -> None:
    data = load_dataset(store(tmp_path))
    frames = np.concatenate([make(i).frames for i in (0, 2)]).reshape(-1, 3).astype(float)
    change = np.concatenate([make(i).frames.astype(float) - make(i).background for i in (0, 2)]).reshape(-1, 3)
    # Sums of whole numbers are exact; the root of a difference of float64 keeps 1e-12.
    np.testing.assert_allclose(data.stats["mean"], frames.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(data.stats["std"], frames.std(axis=0), rtol=1e-10)
    np.testing.assert_allclose(data.stats["change_std"], change.std(axis=0), rtol=1e-10)


def test_bytes_depend_on_the_episode_alone(tmp_path: Path) -> None:
    one, other = (write_episode(tmp_path / name, make(7)).read_bytes() for name in "ab")
    assert one == other
    changed = make(7)
    changed.frames[0, 0, 0, 0] ^= 1
    assert write_episode(tmp_path / "c", changed).read_bytes() != one


def test_reading_needs_no_simulator(tmp_path: Path) -> None:
    store(tmp_path)
    code = (
        "import sys, gelsim; d = gelsim.load_dataset(sys.argv[1]); e = d.read(1); assert isinstance(e, gelsim.Episode);"
        "print([m for m in ('warp', 'mitsuba', 'drjit', 'pytetwild', 'torch', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_killed_writer_leaves_nothing_half(tmp_path: Path) -> None:
    store(tmp_path)
    partial = tmp_path / "episodes/00000/.000003.tar-1.partial"
    partial.write_bytes(b"half")
    assert [row["index"] for row in survey(tmp_path).rows] == [0, 1, 2] and not partial.exists()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"motion": "alien"}, "allowed are human, robot"),
        ({"file": "../../etc/passwd"}, "lies in 'episodes"),
        ({"group": True}, "group = True"),
        ({"radius_mm": "5"}, "radius_mm"),
        ({"frames": 4}, "its row says 4 frames"),
    ],
)
def test_wrong_rows_are_refused(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(DatasetError, match=said):
        write_episode(tmp_path, make(**fields))
    assert not list(tmp_path.rglob("*.tar"))


def test_rows_from_strangers_are_checked(tmp_path: Path) -> None:
    store(tmp_path)
    path = tmp_path / "meta/episodes.jsonl"
    lines = path.read_text().splitlines()
    row = json.loads(lines[1])
    for changed, said in (
        (row | {"file": "/etc/passwd"}, "line 2: file"),
        ({k: v for k, v in row.items() if k != "shape"}, "line 2: shape is missing"),
        (row | {"index": 0, "file": episode_file(0)}, "an index occurs twice"),
    ):
        path.write_text("\n".join([lines[0], json.dumps(changed), lines[2]]) + "\n")
        with pytest.raises(DatasetError, match=said):
            load_dataset(tmp_path)
    path.write_text("[1")
    with pytest.raises(DatasetError, match="cannot be read"):
        load_dataset(tmp_path)


def rewritten(path: Path, name: str, content: bytes) -> None:
    with tarfile.open(path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    write_tar(path, files | {name: content})


def test_damaged_and_hostile_episodes_are_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_episode(tmp_path, make())
    whole = path.read_bytes()

    def refused(said: str) -> None:
        with pytest.raises(DatasetError, match=said) as error:
            read_episode(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value)

    class Evil:
        def __reduce__(self) -> Any:
            return (pytest.fail, ("unpickled",))

    for content in (np.array([Evil()], object), {"time": 1}):
        buffer = io.BytesIO()
        np.savez(buffer, time=content) if isinstance(content, np.ndarray) else buffer.write(pickle.dumps(content))
        rewritten(path, "labels.npz", buffer.getvalue())
        refused("damaged")
        path.write_bytes(whole)
    rewritten(path, "frames/0001.webp", b"no picture")
    refused("damaged")
    path.write_bytes(whole)
    rewritten(path, "frames/0001.webp", dataset.webp(np.zeros((2, 2, 3), np.uint8)))
    refused("not of one size")
    path.write_bytes(whole[: len(whole) // 2])
    refused("damaged|missing")
    path.write_bytes(whole)
    monkeypatch.setattr(dataset, "MOST_PIXELS", 100)
    refused("a picture of 16 × 12 pixels")
    monkeypatch.undo()
    monkeypatch.setattr(dataset, "LARGEST_FILE", 100)
    refused("bytes; allowed")
    monkeypatch.undo()
    with tarfile.open(path, "w") as tar:
        link = tarfile.TarInfo("frames/0000.webp")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(link)
    refused("row.json is missing")
    path.unlink()
    refused("cannot be read")


def test_what_is_no_dataset_says_so(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is no dataset"):
        load_dataset(tmp_path)
    store(tmp_path)
    splits = tmp_path / "meta/splits.json"
    splits.write_text('{"train": [99]}')
    with pytest.raises(DatasetError, match="'train' names an episode that is not there"):
        load_dataset(tmp_path)
    info = tmp_path / "meta/info.json"
    info.write_text('{"schema": 99}')
    with pytest.raises(DatasetError, match="its schema is 99"):
        load_dataset(tmp_path)


def test_a_place_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "episodes").write_text("a file where a folder is wanted")
    with pytest.raises(DatasetError, match="000000.tar: cannot be written"):
        write_episode(tmp_path, make())
    with pytest.raises(DatasetError, match="cannot be written"):
        write_meta(tmp_path / "episodes", {}, Survey([], {}), [], {})


def test_episodes_of_wrong_shapes_are_refused() -> None:
    with pytest.raises(DatasetError, match="force has shape"):
        replace(make(), force=np.zeros((2, 3)))
    with pytest.raises(DatasetError, match="uint8 is wanted"):
        replace(make(), frames=make().frames.astype(float))


def test_the_mini_dataset_is_whole() -> None:
    from gelsim.scene.layers import assets_folder

    folder = assets_folder() / "mini"
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= 8_000_000
    data = load_dataset(folder)
    assert len(data) == 60 and not data.failures and survey(folder).rows == data.rows
    assert sorted(index for rows in data.splits.values() for index in rows) == [row["index"] for row in data.rows]
    for position in range(0, len(data), 9):
        episode = data.read(position)
        assert episode.frames.shape[1:] == (120, 160, 3) and (episode.frames[-1] != episode.background).any()
        assert set(data.member(position, "mechanics.npz")[:2]) == set(b"PK")
