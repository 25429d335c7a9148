"""A page of viser with one node, and a slider whose value comes back as a text: how long Chromium and viser need for a
first picture and for a round trip without fdcal.

A program: python -m benchmarks.empty_page
"""

import contextlib
import sys
import time

import viser

NODE = "/microphones/true"  # that `benchmarks.pages.open_page` waits for
SLIDER = "Echo"


def main() -> None:
    with contextlib.redirect_stdout(sys.stderr):  # viser prints a table
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    print(f"http://127.0.0.1:{server.get_port()}", flush=True)
    server.scene.add_frame(NODE)
    slider, echo = server.gui.add_slider(SLIDER, 0, 99, 1, 50), server.gui.add_html("")

    @slider.on_update
    async def _(event) -> None:
        echo.content = f"<!--{event.target.value}-->"

    while True:
        time.sleep(3600)


if __name__ == "__main__":
    main()
