"""An empty page of viser with one node: what Chromium and viser take for a first picture without fdcal.

A program: python -m benchmarks.empty_page
"""

import contextlib
import sys
import time

import viser

NODE = "/microphones/true"  # that `benchmarks.pages.open_page` waits for


def main() -> None:
    with contextlib.redirect_stdout(sys.stderr):  # viser prints a table
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    print(f"http://127.0.0.1:{server.get_port()}", flush=True)
    server.scene.add_frame(NODE)
    while True:
        time.sleep(3600)


if __name__ == "__main__":
    main()
