"""The page without installing a command: `python app.py [SCENE] [--port 8080] ...`, the same as `fdcal view`."""

import sys

from fdcal.commands.cli import main

if __name__ == "__main__":
    main(["view", *sys.argv[1:]])
