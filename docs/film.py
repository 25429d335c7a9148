"""Make the film of the README, with which the page opens: `python docs/film.py`. Look at it before you commit it.

A real browser draws each picture, as the page does (playwright and Chromium, as for the tests).
"""

from __future__ import annotations

import io
import math
import sys
from pathlib import Path

from PIL import Image

from fdcal.viewer.opening import film_html
from fdcal.viewer.server.hardening import STYLE

PATH = Path(__file__).parent / "pictures" / "opening.webp"
SIZE, SCALE = {"width": 640, "height": 480}, 1  # CSS pixels of the page; pixels of the film per CSS pixel
FRAMES, LAST = 12, 2.5  # frames per second; s for which the last frame stays
QUALITY = 70


def main() -> None:
    """Write the film."""
    sys.path.insert(0, str(Path(__file__).parent.parent))
    from playwright.sync_api import sync_playwright

    from benchmarks.pages import launch

    html = f"<!doctype html><style>{STYLE.read_text(encoding='utf-8')} #fdcal-film button {{display: none}}</style>"
    images, durations, shown = [], [], None
    with sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport=SIZE, device_scale_factor=SCALE, color_scheme="dark")
        page.set_content(html + film_html())
        page.evaluate("fdcalFilm.hold()")
        length = page.evaluate("fdcalFilm.length")
        for number in range(math.ceil(length * FRAMES) + 1):
            time = number / FRAMES
            moment = page.evaluate("time => JSON.stringify(fdcalFilm.moment(time))", time)
            if moment == shown:  # the picture has not changed
                durations[-1] += 1000 / FRAMES
                continue
            shown = moment
            page.evaluate("time => new Promise(done => { fdcalFilm.draw(time); requestAnimationFrame(done); })", time)
            images.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
            durations.append(1000 / FRAMES)
        browser.close()
    durations[-1] = 1000 * LAST
    images[0].save(
        PATH, save_all=True, append_images=images[1:], duration=[round(time) for time in durations], loop=0,
        quality=QUALITY, method=6,
    )  # fmt: skip
    print(f"{PATH.name}: {len(images)} pictures, {sum(durations) / 1000:.0f} s, {PATH.stat().st_size} bytes")


if __name__ == "__main__":
    main()
