"""Make the film of the README, with which the page opens: `python docs/film.py`. Look at it before you commit it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from fdcal.graphics.annotations import font
from fdcal.graphics.snapshot import draw
from fdcal.viewer.opening import Projector, opening_request

PATH = Path(__file__).parent / "pictures" / "opening.webp"
SIZE, TOP, LETTERS = (640, 480), 34, 30  # pixels: of the film, from its edge to the middle of the words, of these
FRAMES, LAST = 12, 2.5  # per second, and s that the last one stays
QUALITY = 70


def main() -> None:
    """Write the film."""
    measurement = opening_request().measurement
    if measurement is None:
        raise ValueError("the opening has a measurement")
    projector, images, durations = Projector(measurement), [], []
    shown: tuple = ()
    for number in range(math.ceil(projector.film.length * FRAMES) + 1):
        moment = projector.film.at(number / FRAMES)
        key = moment.index, moment.share, moment.words, *moment.place
        if key == shown:  # it stays as it is
            durations[-1] += 1000 / FRAMES
            continue
        shown, picture = key, projector.picture(moment, dark=True)
        labels = tuple(label for label in picture.labels if label.name == "selected/name")
        image = draw(replace(picture, labels=labels, floor=replace(projector.floor(moment), bar=None)), SIZE, "close")
        images.append(_with_words(image, moment.words, picture.theme.foreground))
        durations.append(1000 / FRAMES)
    durations[-1] = 1000 * LAST
    images[0].save(
        PATH, save_all=True, append_images=images[1:], duration=[round(time) for time in durations], loop=0,
        quality=QUALITY, method=6,
    )  # fmt: skip
    print(f"{PATH.name}: {len(images)} pictures, {sum(durations) / 1000:.0f} s, {PATH.stat().st_size} bytes")


def _with_words(image: np.ndarray, words: str, ink: tuple[int, int, int]) -> Image.Image:
    framed = Image.fromarray(image)
    place = SIZE[0] / 2, TOP
    ImageDraw.Draw(framed).text(place, words, fill=ink, font=font(LETTERS), anchor="mm")
    return framed


if __name__ == "__main__":
    main()
