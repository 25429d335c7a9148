"""The server of the page: who may connect, which values are accepted, and the log.

May import: the packages below viewer.

hardening      a server that only its own page can use, with a bounded rate for each client; workarounds for viser
client_values  checks of messages and of the values in them
process        the error log, and the memory of the process
"""

# The regions over the canvas that `page.js` fills with the HTML of hidden controls.
# words: large text in the middle; invitation: text at the same place after the film; caption: text of a lesson; legend:
# scale and marks; bar: the bar of the layout Explore; sheet: the sheet above the bar; address: the part of the page's
# address that is common to all browsers; lecture: "on" in lecture mode.
REGIONS = ("words", "invitation", "caption", "legend", "bar", "sheet", "address", "lecture")


def content(region: str, html: str = "") -> str:
    """Return what a hidden control sends to fill a region with HTML."""
    return f"<!--fdcal:{region}-->{html}"
