"""Where the mouse is on the picture. viser 1.1 reports clicks and no motion, so a script in the page reports it.

The script writes "cursor x y" (shares of the picture's width and height) into a text field of viser, which it hides,
and shows the value that the server answers beside the mouse.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from html import escape

import viser

START = "cursor"
VALUE_ID = "tdgbench-value"  # of the element whose text is shown beside the mouse
SCRIPT = """
(() => {
  if (window.tdgbenchCursor) return;
  window.tdgbenchCursor = true;
  const field = () => [...document.querySelectorAll("input")].find((one) => one.value.startsWith("START"));
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  const tip = document.createElement("div");
  tip.id = "tdgbench-tip";
  tip.style = "position:fixed;pointer-events:none;display:none;z-index:50;padding:0.1em 0.4em;border-radius:3px;"
    + "font:13px sans-serif;color:#fff;background:rgba(0,0,0,0.7)";
  document.body.append(tip);
  let place = null;
  document.addEventListener("pointermove", (event) => {
    place = event.target.tagName === "CANVAS" && !event.buttons ? event : null;
    if (!place) tip.style.display = "none";
  });
  setInterval(() => {
    const found = field();
    if (!found) return;
    let row = found;
    while (!row.querySelector("label")) row = row.parentElement;
    row.parentElement.style.display = "none";
    if (!place) return;
    const box = place.target.getBoundingClientRect();
    const x = (place.clientX - box.left) / box.width, y = (place.clientY - box.top) / box.height;
    const text = `START ${x.toFixed(4)} ${y.toFixed(4)}`;
    if (found.value !== text) {
      write.call(found, text);
      found.dispatchEvent(new Event("input", { bubbles: true }));
    }
    tip.textContent = document.getElementById("VALUE_ID")?.textContent ?? "";
    tip.style.left = `${place.clientX + 14}px`;
    tip.style.top = `${place.clientY + 14}px`;
    tip.style.display = tip.textContent ? "block" : "none";
  }, 50);
})()
""".replace("START", START).replace("VALUE_ID", VALUE_ID)


def watch_cursor(gui: viser.GuiApi, on_move: Callable[[float, float], None]) -> None:
    """Call on_move(x, y) when the mouse moves over the picture; both are shares in [0, 1]."""
    field = gui.add_text("Cursor", f"{START} - -")
    gui.add_html(f'<img src="data:," style="display:none" onerror="{escape(SCRIPT)}">')

    @field.on_update
    def _(_: viser.GuiEvent) -> None:
        place = parse_place(field.value)
        if place is not None:
            on_move(*place)


def parse_place(text: str) -> tuple[float, float] | None:
    """Return the shares x and y that the script wrote; None for any other text.

    >>> parse_place("cursor 0.2500 1.0000"), parse_place("cursor - -"), parse_place("cursor nan 0.1")
    ((0.25, 1.0), None, None)
    """
    words = text.split()
    try:
        x, y = (float(word) for word in words[1:])
    except ValueError:
        return None
    return (x, y) if words[0] == START and math.isfinite(x) and math.isfinite(y) else None
