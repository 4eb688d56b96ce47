"""The controls of one browser: what is shown, the value of a pixel, and a colour bar."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape

import numpy as np
import viser
from PIL import Image

from tdgbench.present.colours import in_colour, lookup_table
from tdgbench.scenes.modalities import LABELS
from tdgbench.view.cells import ViewedCell
from tdgbench.view.renderer import COLOR_MAPS, GEOMETRY, QUANTITIES, Look, RenderedLook

STOPS = 12  # colours of a colour bar
STYLE = "font-size:0.8em;padding:0 0.75em 0.5em"
ALONE = "–"  # choice of no second cell
PREVIOUS, NEXT = "← previous", "next →"
PICTURE_WIDTH = 360  # px
NOTHING = np.zeros((1, 1, 3), np.uint8)


def value_text(values: np.ndarray, quantity: str, degC: tuple[float, float] | None) -> str:
    """Return one pixel's values (C,) in words. degC: temperatures of the image values 0 and 1, if they are known.

    >>> value_text(np.array([0.5]), "thermal", (20.0, 30.0)), value_text(np.array([0.5]), "thermal", None)
    ('25.0 °C', '0.500')
    >>> value_text(np.array([np.nan]), "depth", None), value_text(np.array([0.1, 0.2, 1.0]), "rgb", None)
    ('no surface', '0.100 0.200 1.000')
    >>> value_text(np.array([2.5]), "depth", None)
    'z 2.500'
    """
    if not np.isfinite(values).all():
        return "no surface"
    if quantity == "thermal" and len(values) == 1 and degC is not None:
        return f"{degC[0] + float(values[0]) * (degC[1] - degC[0]):.1f} °C"
    text = " ".join(f"{value:.3f}" for value in values)
    return f"z {text}" if quantity == "depth" else text


def readout(shown: list[tuple[str, np.ndarray]], cells: Mapping[str, ViewedCell], quantity: str) -> str:
    """Return the values of a pixel, of each cell."""
    texts = [value_text(values, quantity, cells[name].degC) for name, values in shown]
    if len(shown) == 1:
        return texts[0]
    return " · ".join(f"{name} {text}" for (name, _), text in zip(shown, texts, strict=True))


def color_bar(frame: RenderedLook, cells: Mapping[str, ViewedCell]) -> str:
    """Return the colour bar of a rendered look with the values at its ends; none for pictures in colour."""
    look, whole = frame.look, frame.whole
    if whole is None:
        return ""
    ends = [np.array([whole[0] + share * (whole[1] - whole[0])]) for share in look.span]
    known = [cells[part.cell].degC for part in frame.parts]
    texts = [value_text(end, look.quantity, None if None in known else known[0]) for end in ends]
    table = lookup_table(look.colors)[np.linspace(0, 255, STOPS).astype(int)]
    stops = ",".join(f"rgb({r},{g},{b})" for r, g, b in table)
    return (
        f'<div style="{STYLE}"><div style="height:0.8em;border-radius:2px;background:linear-gradient(90deg,{stops})">'
        '</div><div style="display:flex;justify-content:space-between">'
        f"{''.join(f'<span>{escape(text)}</span>' for text in texts)}</div></div>"
    )


class Panel:
    """Controls of a client. on_look and on_view are called when a look or a view is chosen, on_step with −1 or 1."""

    def __init__(
        self,
        gui: viser.GuiApi,
        cells: Mapping[str, ViewedCell],
        on_look: Callable[[], None],
        on_view: Callable[[str], None],
        on_step: Callable[[int], None],
    ) -> None:
        self.cells, self._on_look, self._on_view, self._on_step = cells, on_look, on_view, on_step
        first = next(iter(cells.values()))
        self.views = [*sorted(first.test), *sorted(first.train)]
        self._labels = {view: f"{view} ({'test' if view in first.test else 'training'})" for view in self.views}
        self.readout, self._value = gui.add_html(""), ""
        self.show_value("")
        self._add_look(gui)
        self._add_views(gui)

    def look(self) -> Look:
        """Return what the controls say; viser takes any value of theirs from a client."""
        cell, beside, quantity, colors = map(_choice, (self._cell, self._beside, self._quantity, self._colors))
        low, high, divide = (min(max(one, 0), 100) for one in (*self._span.value, self._divide.value))
        return Look(
            cell=cell,
            quantity=self._quantities[quantity],
            colors=colors,
            span=(low / 100, max(high, low + 1) / 100),
            beside="" if beside == ALONE else beside,
            divide=divide / 100,
            guesses=self._guesses.value,
        )

    def remove(self) -> None:
        for part in (self.readout, self._picture, self._stand):
            part.remove()

    def describe(self, frame: RenderedLook) -> None:
        """Bring the colour bar and the choices up to date with a frame."""
        self.show_value(self._value)
        self._bar.content = color_bar(frame, self.cells)
        self._colors.visible = self._span.visible = frame.whole is not None

    def show_value(self, text: str) -> None:
        """Show the scene, the state of a followed cell, and the value of the pixel that was clicked."""
        self._value, first = text, next(iter(self.cells.values()))
        title = first.record.title if first.state else f"{first.record.dataset}/{first.record.scene}"
        value = f'{escape(first.state)}<br><span id="tdgbench-value">{escape(text)}</span>'
        self.readout.content = f'<div style="{STYLE};min-height:3.2em"><b>{escape(title)}</b><br>{value}</div>'

    def show_view(self, view: str) -> None:
        """Show the name and the stored pictures of the view that the camera stands at."""
        self._view.value = self._labels[view]  # type: ignore[misc] # mypy misses the setter
        try:
            pictures = {what: one for cell in self.cells.values() for what, one in cell.pictures(view).items()}
        except ValueError as error:  # the file has changed since the cell was opened
            pictures = {}
            self.show_value(str(error))
        for modality, image in self._images.items():
            image.visible = modality in pictures
            if modality in pictures:
                image.image = _fitted(pictures[modality])

    def _add_look(self, gui: viser.GuiApi) -> None:
        names = list(self.cells)
        there = {modality for cell in self.cells.values() for modality in cell.modalities}
        shown = [quantity for quantity in QUANTITIES if quantity in GEOMETRY or quantity in there]
        self._quantities = {LABELS.get(quantity, quantity): quantity for quantity in shown}
        several = len(names) > 1
        with gui.add_folder("Picture") as self._picture:
            self._cell = gui.add_dropdown("Cell", names, visible=several)
            self._beside = gui.add_dropdown(
                "Beside", [ALONE, *names], initial_value=names[1] if several else ALONE, visible=several
            )
            self._divide = gui.add_slider("Divide", 0, 100, 1, 50, visible=several)
            self._quantity = gui.add_dropdown("Show", list(self._quantities))
            self._colors = gui.add_dropdown("Colours", COLOR_MAPS)
            self._span = gui.add_multi_slider("Range, %", 0, 100, 1, (0, 100), min_range=1)
            of_gaussians = any(cell.models for cell in self.cells.values())
            self._guesses = gui.add_checkbox("Guesses in blue", False, visible=of_gaussians)
            self._bar = gui.add_html("")
        choices = (self._cell, self._beside, self._divide, self._quantity, self._colors, self._span, self._guesses)
        for control in choices:
            control.on_update(lambda _: self._on_look())

    def _add_views(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Views") as self._stand:
            self.cameras = gui.add_checkbox("Cameras", True)
            self._view = gui.add_dropdown("View", list(self._labels.values()))
            buttons = gui.add_button_group("", [PREVIOUS, NEXT])
            self._images = {
                modality: gui.add_image(NOTHING, label=label, visible=False) for modality, label in LABELS.items()
            }
        names = {label: view for view, label in self._labels.items()}

        @self._view.on_update
        def _(event: viser.GuiEvent) -> None:
            if event.client is not None:  # not set by this program
                self._on_view(names[_choice(self._view)])

        @buttons.on_click
        def _(_: viser.GuiEvent) -> None:
            self._on_step(1 if buttons.value == NEXT else -1)


def _choice(control: viser.GuiDropdownHandle[str]) -> str:
    """Return the option that is chosen; the first one if there is none of that name."""
    return control.value if control.value in control.options else control.options[0]


def _fitted(picture: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 1 or 3) uint8 in colour, as wide as the panel."""
    height = max(1, round(picture.shape[0] * PICTURE_WIDTH / picture.shape[1]))
    return np.asarray(Image.fromarray(in_colour(picture)).resize((PICTURE_WIDTH, height)))
