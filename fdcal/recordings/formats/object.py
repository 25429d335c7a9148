"""JSON: one object with the frame and a list of microphones."""

from __future__ import annotations

import json
from pathlib import Path

from ...model.given_positions import MicrophonePositions

SUFFIXES = (".json",)


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`, metres; an unknown uncertainty is null."""
    microphones = [
        {
            "name": name,
            **dict(zip("xyz", place, strict=True)),
            "uncertainty": None if placed.uncertainty is None else float(placed.uncertainty[n]),
        }
        for n, (name, place) in enumerate(zip(placed.names, placed.positions.tolist(), strict=True))
    ]
    table = {"unit": "metre", "frame": placed.frame, "microphones": microphones}
    path.write_text(json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
