"""The verdict and the channels of a finished run as HTML: gain, phase and noise of each, the odd ones first."""

from __future__ import annotations

from html import escape

from ...model.measurement import Measurement
from ..background.uncertainty import PositionUncertainty
from .html import CARD, RED
from .verdict_html import verdict_word

MAX_ROWS = 100  # of the table
HEAD = ("mic", "gain<br>(dB)", "phase<br>(&deg;)", "noise<br>(dB)", "")


def channel_table(measurement: Measurement, found: PositionUncertainty | None) -> str:
    """Return the verdict and a table of the channels; "" where there are none.

    Parameters
    ----------
    measurement : Measurement
    found : PositionUncertainty of the state, or None
    """
    if found is None or found.channels is None:
        return ""
    channels = found.channels
    faults = {fault.name: fault.text.partition(": ")[2] for fault in channels.faults}
    names = [str(name) for name in measurement.names]
    rows = []
    for n in sorted(range(len(names)), key=lambda n: (names[n] not in faults, n))[:MAX_ROWS]:
        fault = faults.get(names[n], "")
        style = f" style='font-weight: 700; color: {RED}'" if fault else ""
        cells = (
            ("&#9888; " if fault else "") + escape(names[n]),
            f"{channels.gain_db[n]:+.2f} &plusmn; {channels.gain_sigma_db[n]:.2f}",
            f"{channels.phase_deg[n]:+.1f} &plusmn; {channels.phase_sigma_deg[n]:.1f}",
            f"{channels.noise_db[n]:+.1f}",
            escape(fault),
        )
        rows.append(f"<tr{style}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    head = "".join(f"<th>{text}</th>" for text in HEAD)
    return (
        f"<div style='{CARD} font-size: 0.74em; overflow-x: auto'>"
        f"<b>Verdict: {escape(verdict_word(found.verdict))}</b><br>"
        f"{escape(found.text)}<table class='mics'><tr>{head}</tr>{''.join(rows)}</table></div>"
    )
