"""Are pictures called unlike the training that are no press? Films of other things, drawn by a seed, read by networks.

    python docs/studies/no_presses.py [--seeds 4] [--model default]

Nineteen kinds: made-up scenes, textures and text that are moved past, enlarged, shaken, cut, faded, dimmed or tinted; something that comes
in from the side; a turning gradient, a chess board, stripes, balls, a curve that grows, noise. Prints the share called unlike, the kinds of
which one is not, and the reading beside.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image, ImageDraw

from learn.predict import find_models, predict

HEIGHT, WIDTH, FRAMES = 240, 320, 40
TIMES = np.linspace(0.0, 1.0, FRAMES)
Film = list[np.ndarray]
Rng = np.random.Generator


def texture(rng: Rng, power: float) -> np.ndarray:
    """Coloured noise with a spectrum that falls by frequency to `power`, (480, 640, 3)."""
    frequency = np.hypot(np.fft.fftfreq(2 * HEIGHT)[:, None], np.fft.fftfreq(2 * WIDTH)[None])
    frequency[0, 0] = 1.0
    drawn = [np.fft.ifft2(np.fft.fft2(rng.normal(size=frequency.shape)) / frequency**power).real for _ in range(3)]
    return np.stack([128 + 45 * part / part.std() for part in drawn], axis=2).clip(0, 255).astype(np.uint8)


def scene(rng: Rng) -> np.ndarray:
    """Discs and boxes of all sizes over each other, which have the statistics of photographs."""
    image = Image.fromarray(texture(rng, 1.4))
    draw = ImageDraw.Draw(image)
    for _ in range(rng.integers(30, 120)):
        radius, x, y = min(8 * rng.pareto(1.3) + 5, 150), rng.uniform(0, 2 * WIDTH), rng.uniform(0, 2 * HEIGHT)
        shape = draw.ellipse if rng.random() < 0.5 else draw.rectangle
        shape((x - radius, y - radius * rng.uniform(0.2, 1.0), x + radius, y + radius), fill=tuple(map(int, rng.integers(0, 256, 3))))
    return np.asarray(image)


def text(rng: Rng) -> np.ndarray:
    image = Image.new("RGB", (2 * WIDTH, 2 * HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    for y in range(5, 2 * HEIGHT - 5, 14):
        draw.text((5, y), "".join(rng.choice(list("abcdefghij klmnopqrs tuvwxyz"), 90)), fill="black")
    return np.asarray(image)


def view(image: np.ndarray, x: float = 0.5, y: float = 0.5, zoom: float = 1.0) -> np.ndarray:
    """A part of an image: its place from 0 to 1, its size in frames."""
    wide, high = int(WIDTH * zoom), int(HEIGHT * zoom)
    left, top = (int(np.clip(place, 0, 1) * (size - part)) for place, size, part in ((x, image.shape[1], wide), (y, image.shape[0], high)))
    part = Image.fromarray(image[top : top + high, left : left + wide])
    return np.asarray(part.resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR))


def moved(image: np.ndarray, rng: Rng) -> Film:
    angle = rng.uniform(0, 2 * np.pi)
    return [view(image, 0.5 + 0.3 * t * np.cos(angle), 0.5 + 0.3 * t * np.sin(angle)) for t in TIMES]


def faded(first: np.ndarray, second: np.ndarray) -> Film:
    return [((1 - t) * view(first) + t * view(second)).astype(np.uint8) for t in TIMES]


def coloured(image: np.ndarray, gain: np.ndarray) -> Film:
    return [(view(image) * (1 + (gain - 1) * t)).clip(0, 255).astype(np.uint8) for t in TIMES]


def comes_in(image: np.ndarray, rng: Rng) -> Film:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    colour = rng.uniform(0, 255, 3)
    hidden = [np.clip(15 * (1 - np.hypot((x + 80 - 200 * t) / 70, (y - 120) / 60)), 0, 1)[..., None] for t in TIMES]
    return [(view(image) * (1 - part) + colour * part).astype(np.uint8) for part in hidden]


def drawn(rng: Rng, draw: Callable[[ImageDraw.ImageDraw, float], None], keep: bool) -> Film:
    """What a function of the time draws on a plain ground, each frame over the last if `keep`."""
    ground = Image.new("RGB", (WIDTH, HEIGHT), tuple(map(int, rng.integers(60, 256, 3))))
    film = []
    for t in TIMES:
        image = ground if keep else ground.copy()
        draw(ImageDraw.Draw(image), float(t))
        film.append(np.array(image))
    return film


def balls(rng: Rng) -> Film:
    places, speeds, colours = rng.uniform(40, 200, (6, 2)), rng.normal(scale=160, size=(6, 2)), rng.integers(0, 256, (6, 3))

    def draw(on: ImageDraw.ImageDraw, t: float) -> None:
        for (x, y), colour in zip(places + t * speeds, colours, strict=True):
            on.ellipse((x - 18, y - 18, x + 18, y + 18), fill=tuple(map(int, colour)))

    return drawn(rng, draw, keep=False)


def curve(rng: Rng) -> Film:
    heights = np.cumsum(np.append(120.0, rng.normal(scale=15, size=FRAMES - 1)))

    def draw(on: ImageDraw.ImageDraw, t: float) -> None:
        last = round(t * (FRAMES - 1))
        if last:
            on.line((8 * last - 8, heights[last - 1], 8 * last, heights[last]), fill=(200, 0, 0), width=2)

    return drawn(rng, draw, keep=True)


def films(rng: Rng) -> Iterator[tuple[str, Film]]:
    """A film of each kind."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    one, other, rough, smooth, written = scene(rng), scene(rng), texture(rng, 1.0), texture(rng, 2.0), text(rng)
    yield from (
        (f"{name}, moved", moved(image, rng)) for name, image in (("scene", one), ("rough", rough), ("smooth", smooth), ("text", written))
    )
    yield from (
        (f"{name}, enlarged", [view(image, zoom=1.9 - 1.2 * t) for t in TIMES]) for name, image in (("scene", one), ("smooth", smooth))
    )
    for name, image in (("scene", one), ("text", written)):
        yield f"{name}, shaken", [view(image, *(0.5 + 0.02 * rng.normal(size=2))) for _ in TIMES]
    yield "scenes, cut", [view(one)] * (FRAMES // 2) + [view(other)] * (FRAMES // 2)
    yield "scenes, faded", faded(one, other)
    yield "smooth, faded", faded(smooth, texture(rng, 2.0))
    for name, image in (("scene", one), ("smooth", smooth)):
        yield f"{name}, dimmed", coloured(image, np.full(3, 0.5))
        yield f"{name}, tinted", coloured(image, rng.uniform(0.5, 1.5, 3))
        yield f"{name}, something comes in", comes_in(image, rng)
    turned = [((x - 160) * np.cos(2 * np.pi * t) + (y - 120) * np.sin(2 * np.pi * t)) / 2 + 128 for t in TIMES]
    yield "gradient", [np.stack([part, 255 - part, part / 2 + 60], axis=2).clip(0, 255).astype(np.uint8) for part in turned]
    yield (
        "chess board",
        [np.repeat(((((x + 80 * t) // 20 + (y + 40 * t) // 20) % 2) * 255).astype(np.uint8)[..., None], 3, 2) for t in TIMES],
    )
    stripes = rng.integers(0, 256, (8, 3), dtype=np.uint8)
    yield "stripes", [stripes[((x + 320 * t) // 40).astype(int) % 8] for t in TIMES]
    yield "balls", balls(rng)
    yield "curve", curve(rng)
    yield "noise", list(rng.integers(0, 256, (FRAMES, HEIGHT, WIDTH, 3), dtype=np.uint8))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--model", default="default")
    options = parser.parse_args()
    called = []
    for seed in range(options.seeds):
        for name, film in films(np.random.default_rng(seed)):
            with TemporaryDirectory() as folder:
                for number, frame in enumerate(film):
                    Image.fromarray(np.ascontiguousarray(frame)).save(Path(folder) / f"{number:04d}.png", compress_level=1)
                (answer,) = predict(find_models([options.model]), [Path(folder)], sensor="fingertip2017", device="cpu")
            called.append(answer["status"] != "ok" or answer["unlike_training"])
            if not called[-1]:
                print(f"{name}, seed {seed}: read as a press, Shore 00 {answer['shore_00']:.0f} ± {answer['spread']:.0f}", flush=True)
    print(f"refused or called unlike the training: {np.sum(called)} of {len(called)} films, {100 * np.mean(called):.0f} %")


if __name__ == "__main__":
    main()
