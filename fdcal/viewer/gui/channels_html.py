"""The verdict of a finished run as HTML: gain, phase and noise of each channel, and given positions as corrected."""

from __future__ import annotations

from html import escape

from ...model.measurement import Measurement
from ...model.texts import mm_text
from ..background.uncertainty import PositionUncertainty
from .html import CARD, RED
from .verdict_html import verdict_word

MAX_ROWS = 100  # of the table
GIVEN_HEAD = ("mic", "difference<br>(mm)", "&sigma;<br>(mm)", "given<br>(m)", "found<br>(m)")
HEAD = ("mic", "gain<br>(dB)", "phase<br>(&deg;)", "noise<br>(dB)")


def channel_table(measurement: Measurement, found: PositionUncertainty | None) -> str:
    """Return the verdict and a table of the channels; "" where there are none.

    `found`: PositionUncertainty of the state, or None.
    """
    if found is None or found.channels is None:
        return ""
    channels, sought = found.channels, found.channels.gains_sought
    faults = {fault.name: fault.text.partition(": ")[2] for fault in channels.faults}
    names = [str(name) for name in measurement.names]
    rows = []
    for n in sorted(range(len(names)), key=lambda n: (names[n] not in faults, n))[:MAX_ROWS]:
        fault = faults.get(names[n], "")
        style = f" style='font-weight: 700; color: {RED}'" if fault else ""
        cells = (
            ("&#9888; " if fault else "") + escape(names[n]),
            f"{channels.gain_db[n]:+z.2f}" + (f" &plusmn; {channels.gain_sigma_db[n]:.2f}" if sought else ""),
            f"{channels.phase_deg[n]:+z.1f}" + (f" &plusmn; {channels.phase_sigma_deg[n]:.1f}" if sought else ""),
            f"{channels.noise_db[n]:+z.1f}",
        )
        rows.append(f"<tr{style}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
        if fault:  # in a row of its own, for the panel is narrow
            rows.append(f"<tr{style}><td colspan='{len(HEAD)}' style='white-space: normal'>{escape(fault)}</td></tr>")
    head = "".join(f"<th>{text}</th>" for text in HEAD)
    return (
        f"<div style='{CARD} font-size: 0.74em; overflow-x: auto'>"
        f"<b>Verdict: {escape(verdict_word(found.verdict))}</b><br>"
        f"{escape(found.text)}<table class='mics'><tr>{head}</tr>{''.join(rows)}</table></div>"
    )


def given_table(found: PositionUncertainty | None) -> str:
    """Return a table of the given positions as corrected, the most corrected first; "" where there are none.

    `found`: PositionUncertainty of the state, or None.
    """
    if found is None or found.channels is None or not found.channels.given:
        return ""
    rows = []
    for one in sorted(found.channels.given, key=lambda one: -one.difference)[:MAX_ROWS]:
        style = f" style='font-weight: 700; color: {RED}'" if one.wrong else ""
        cells = (
            ("&#9888; " if one.wrong else "") + escape(one.name),
            mm_text(one.difference),
            f"&plusmn; {mm_text(one.sigma)}",
            *(",<br>".join(f"{x:.4f}" for x in place) for place in (one.given, one.found)),
        )
        rows.append(f"<tr{style}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    head = "".join(f"<th>{text}</th>" for text in GIVEN_HEAD)
    return (
        f"<div style='{CARD} font-size: 0.74em; overflow-x: auto'><b>Given positions</b>"
        f"<table class='mics'><tr>{head}</tr>{''.join(rows)}</table></div>"
    )
