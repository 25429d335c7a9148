"""The scene: its nodes and texts, of which only changes are sent, and the camera of each page.

A camera is placed so that the picture fills the space that the panels leave, and is placed again when this space
changes. viser replaces its copy of a page's camera whenever the page reports it, even between two of our commands.
viser does not send a value that equals its copy, so that a page may have a new position and an old direction. A camera
therefore counts as placed only when the page has reported the camera that was commanded.

viser would draw a text in black on a white box, in a size that depends on the room. `server/page.js` draws texts in the
font of the page, outlined, and leaves out texts that would overlap one of higher priority.
"""

import collections
import contextlib
import itertools
import logging
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from ..acoustics.measure import load_cached_measurement
from ..graphics.camera import Camera, camera_for
from ..graphics.glyphs import grid_faces
from ..graphics.heatmap import relief_grid
from ..graphics.picture import static_picture
from ..graphics.primitives import Floor, Label, Lines, Mesh, Picture, Surface, Theme, by_rank
from ..model.measurement import Measurement
from ..model.scene import MeasuredScene
from ..session.sources import OpenRequest, as_given
from .server import content

if TYPE_CHECKING:
    import trimesh

TOLERANCE = 1e-3  # relative difference up to which camera positions count as equal
AIM_TOLERANCE = 4e-6  # largest error of a camera's aim at its target, relative to the distance of the target
DEPTH_RANGE = 40.0  # objects are drawn at distances from 1 / 40 of the target's distance to 40 times it
MAX_PIXELS = 16384  # largest width or height of a canvas


@dataclass
class PageCamera:
    """The state of one page's camera."""

    expert: bool = False  # whether the page shows the panels
    view: str = "top"  # the last view that was commanded, one of graphics.camera.VIEWS; "" for a `Camera`
    fitted: tuple = ()  # the result of `Cameras._fitted` when it was commanded
    camera: Camera | None = None  # the camera that was commanded, or None
    positions: tuple[tuple[float, float, float], ...] = ()  # the last positions at which it was placed, metres
    checks: int = 0  # number of checks of the canvas since the camera was placed


def planes(wanted: Camera) -> tuple[float, float]:
    """Return the distances from the eye, metres, between which objects are drawn."""
    distance = math.dist(wanted.position, wanted.look_at)
    return distance / DEPTH_RANGE, distance * DEPTH_RANGE


def is_at(camera, wanted: Camera) -> bool:
    """Return whether a page's camera is the one that was commanded: position, direction, field of view, planes.

    The direction must agree to AIM_TOLERANCE: from the top, a tiny angle from straight down decides which way is up.
    """
    off = np.subtract(camera.look_at, camera.position) - np.subtract(wanted.look_at, wanted.position)
    aimed = np.abs(off[:2]).max() <= AIM_TOLERANCE * math.dist(wanted.position, wanted.look_at)
    at = np.allclose(camera.position, wanted.position, rtol=TOLERANCE)
    at = at and np.allclose(camera.look_at, wanted.look_at, rtol=TOLERANCE, atol=TOLERANCE)
    clipped = np.allclose((camera.near, camera.far), planes(wanted), rtol=TOLERANCE, atol=0)
    return bool(at and aimed and clipped and abs(camera.fov - wanted.fov) <= TOLERANCE * wanted.fov)


log = logging.getLogger(__name__)

TOP_FOV = 0.02  # rad; the eye of the top view is so far away that the view is almost a parallel projection
CHECKS = (1, 2, 4, 8, 16)  # numbers of the checks at which the page is made to report the size of its canvas again
VISER_START = (3.0, 3.0, 3.0)  # metres, position of viser's own camera, before a page gets ours
USUAL_CANVAS = (680, 720)  # pixels, assumed width and height until a page has reported its own
KEPT_POSITIONS = 6  # last positions of a camera that are remembered
FOV_NUDGE = 1e-4  # relative change of a field of view that makes the page report its camera
MARGINS = (76, 234, 34, 40)  # pixels left, bottom, right and top of the search domain, for rulers, legend and bar
LECTURE_MARGINS = (110, 350, 60, 50)  # the same in larger type
CAPTION, LECTURE_CAPTION = 350, 486  # width of a caption, pixels, and in lecture mode
WIDE = 900  # least width, pixels, of a canvas that has a caption at its right
# Least width, pixels, and ratio of width to height of a canvas whose legend is beside the map; as in page.js.
BROAD, BROAD_RATIO = 1000, 1.4
BROAD_MARGINS, BROAD_LECTURE_MARGINS = (290, 196, 290, 44), (400, 240, 200, 56)
EXPERT_MARGINS, BROAD_EXPERT_MARGINS = (76, 174, 34, 66), (290, 76, 290, 66)  # beside the panels, without a bar
PHONE_WIDTH = 440  # largest width of the canvas of a phone, pixels
PHONE_PANEL, PHONE_CAPTION = 0.56, 0.53  # fraction of the height of its canvas that a panel or a caption covers
PHONE_MARGINS = (48, 24, 30)  # pixels left, right and top on a phone
# Height, pixels, of legend and rulers above a panel, and of the buttons at the top.
PHONE_LEGEND, PHONE_BUTTONS = 168, 56


@dataclass(eq=False)
class Cameras:
    """Places the cameras of the pages."""

    _server: viser.ViserServer
    picture: Picture | None = None  # the picture on the screen
    view: str = "top"  # view in which a page opens, one of graphics.camera.VIEWS
    # lecture, caption: whether larger type, and the caption of a lesson, need space beside the picture
    lecture: bool = False
    caption: bool = False
    pages: dict[int, PageCamera] = field(default_factory=lambda: collections.defaultdict(PageCamera))  # by client
    # requests of pages, which wait for the main loop
    requests: collections.deque[tuple[viser.ClientHandle, str | Camera | None]] = field(
        default_factory=collections.deque
    )

    def request(self, client: viser.ClientHandle, view: str | Camera | None = None) -> None:
        """Have the main loop place a page's camera or, without a view, check whether its canvas has changed.

        Any thread may call this. Only the main loop places cameras, since two threads could mix their commands.
        """
        self.requests.append((client, view))

    def request_all(self, view: str | Mapping[int, str | Camera]) -> None:
        """`request` one view for every page or, from the result of `kept_views`, each page's own view."""
        for number, client in self._server.get_clients().items():
            if isinstance(view, str) or number in view:
                self.request(client, view if isinstance(view, str) else view[number])

    def show_layout(self, client: viser.ClientHandle, layout: str) -> None:
        """Adapt the camera to a page that shows the panels, "expert", or the bar; on viser's event loop."""
        self.pages[client.client_id].expert = layout == "expert"
        self.request(client)

    def process_requests(self, clients) -> None:
        """Carry out the requests of clients that are still connected, `clients`; only the main loop calls this."""
        while self.requests:
            client, view = self.requests.popleft()
            if client in clients:
                if view is None:
                    self.follow(client)
                else:
                    self.place(client, view)

    def kept_views(self) -> dict[int, str | Camera]:
        """Return the view of each page, by the number of its client.

        A view is one of graphics.camera.VIEWS, or the camera itself if the user has moved it.
        """
        kept = {}
        for number, client in self._server.get_clients().items():
            with self._guarded(client):
                camera, page = client.camera, self.pages[number]
                if page.camera is None or is_at(camera, page.camera):
                    kept[number] = page.view or page.camera or ""
                    continue
                vectors = camera.position, camera.look_at, camera.up_direction
                (x, y, z), (u, v, w), (a, b, c) = ([float(number) for number in vector] for vector in vectors)
                kept[number] = Camera((x, y, z), (u, v, w), (a, b, c), float(camera.fov), 1.0)
        return kept

    def _fitted(self, page: PageCamera, camera, view: str) -> tuple:
        """Return what the placement of a camera depends on: canvas, size of type, caption, panels, height of a relief.

        The height of a relief matters in views from the side only; it is rounded to a centimetre.
        """
        floor = None if self.picture is None or view in ("top", "") else self.picture.floor
        heights = None if floor is None else floor.heights
        relief = 0.0 if heights is None else round(float(heights.max()), 2)
        size = tuple(min(max(round(edge), 1), MAX_PIXELS) for edge in (camera.image_width, camera.image_height))
        return size, self.lecture, self.caption, page.expert, relief

    def place(self, client: viser.ClientHandle, view: str | Camera) -> None:
        """Place one page's camera so that the search domain fills the space that the panels leave.

        `client`: the page; `view`: one of graphics.camera.VIEWS, or the camera itself. A page that reports an
        impossible camera keeps it, and does not affect the others.
        """
        with self._guarded(client):
            camera, page = client.camera, self.pages[client.client_id]
            name, wanted = ("", view) if isinstance(view, Camera) else (view, None)
            fitted = self._fitted(page, camera, name)
            if wanted is None:
                if self.picture is None:
                    return
                size, *around, _ = fitted
                margins, fov = _margins(size, *around), TOP_FOV if name == "top" else None
                wanted = camera_for(self.picture, size, name, margins, fov=fov)
                x, y, z = self._server.initial_camera.position
                before = page.positions or ((x, y, z),)
                before = tuple(p for p in before if not np.allclose(p, wanted.position, rtol=TOLERANCE))
                page.positions = (*before, wanted.position)[-KEPT_POSITIONS:]
            page.view, page.fitted, page.camera, page.checks = name, fitted, wanted, 0
            with client.atomic():
                camera.near, camera.far = planes(wanted)
                camera.fov, camera.up_direction = wanted.fov, wanted.up
                camera.position, camera.look_at = wanted.position, wanted.look_at

    @contextlib.contextmanager
    def _guarded(self, client: viser.ClientHandle) -> Iterator[None]:
        """Catch an exception that a page's camera causes, so that the main loop continues."""
        try:
            yield
        except Exception:
            log.debug("a page reports an impossible camera", exc_info=True)
            self.pages.pop(client.client_id, None)

    def follow(self, client: viser.ClientHandle, check: int | None = None) -> None:
        """Place the camera again if the size of the canvas has changed and the user has not moved the camera.

        A camera at one of its earlier positions was not moved by the user: either the report is old, or the page has
        received its initial position late and has returned to it. At first, a page reports viser's initial position.

        `client`: the page; `check`: number of the check at which the page is made to report its canvas, or None.
        """
        with self._guarded(client):
            page, camera = self.pages[client.client_id], client.camera
            if page.camera is None:
                self.place(client, page.view)
            elif self._fitted(page, camera, page.view) != page.fitted or not is_at(camera, page.camera):
                if any(np.allclose(camera.position, one, rtol=TOLERANCE) for one in (VISER_START, *page.positions)):
                    self.place(client, page.view or page.camera)
            if check is not None:
                # While the panels move, a page may report the old size of its canvas. An invisible change of the field
                # of view makes it report again.
                camera.fov *= 1 + FOV_NUDGE if check % 2 else 1 / (1 + FOV_NUDGE)

    def follow_all(self, clients) -> None:
        """`follow` all pages, whose canvas may have changed without a report; the main loop calls this regularly."""
        for client in clients:
            page = self.pages[client.client_id]
            if page.camera is not None:
                page.checks += 1
                self.follow(client, CHECKS.index(page.checks) if page.checks in CHECKS else None)

    def set_initial(self, picture: Picture) -> None:
        """Set the camera of new pages to `view` of a picture, until the sizes of their canvases are known."""
        fov = TOP_FOV if self.view == "top" else None
        first = self._server.initial_camera
        wanted = camera_for(picture, USUAL_CANVAS, self.view, MARGINS, fov=fov)
        first.near, first.far = planes(wanted)
        first.fov, first.up, first.position, first.look_at = wanted.fov, wanted.up, wanted.position, wanted.look_at


def _margins(size: tuple[int, int], lecture: bool, caption: bool, expert: bool) -> tuple[int, int, int, int]:
    """Return the margins for rulers, legend, bar and caption, pixels: left, bottom, right, top."""
    if size[0] > PHONE_WIDTH or size[1] < 1.6 * size[0]:
        broad = size[0] >= max(BROAD, BROAD_RATIO * size[1])
        if expert and not lecture:  # here a caption is drawn over a panel
            return BROAD_EXPERT_MARGINS if broad else EXPERT_MARGINS
        usual, large = (BROAD_MARGINS, BROAD_LECTURE_MARGINS) if broad else (MARGINS, LECTURE_MARGINS)
        left, bottom, right, top = large if lecture else usual
        if caption and size[0] > WIDE:
            right = (LECTURE_CAPTION if lecture else CAPTION) + min(right, MARGINS[2])
        return left, bottom, right, top
    left, right, top = PHONE_MARGINS
    panel = round((PHONE_CAPTION if caption and not expert else PHONE_PANEL) * size[1])
    return (left, panel + PHONE_LEGEND, right, PHONE_BUTTONS) if expert else (left, panel, right, top)


def labels_html(labels: Iterable[Label], theme: Theme) -> str:
    """Return the texts as elements with position and lift in `data-at`, metres, those of the highest priority first."""
    elements, colours = [], f"color:rgb{theme.foreground};--halo:rgb{theme.background}".replace(" ", "")
    for label in by_rank(labels):
        place = ",".join(f"{x:.4f}" for x in (*label.position, label.lift))
        kind, axis = "name", ""
        if label.name.startswith("frame/"):
            kind, axis = "number", label.name.partition("/")[2][:1]
        elements.append(
            f"<span class='{kind}' data-at='{place}' data-anchor='{label.anchor}' data-axis='{axis}' style='{colours}'>"
            f"{escape(label.text)}</span>"
        )
    return "".join(elements)


def relief_of(floor: Floor, heights: np.ndarray) -> "trimesh.Trimesh":
    """Return a map in relief as a surface through the centres of its pixels, extended to the edges of the map.

    `heights` (ny, nx) float32, metres above the map's own height.
    """
    grid = relief_grid(floor, heights)
    vertices = grid.reshape(-1, 3)
    u, v = (  # limited, because otherwise the colours of opposite edges would mix
        np.clip((places - low) / size, 0.5 / count, 1 - 0.5 / count)
        for places, low, size, count in zip(vertices.T[:2], floor.origin, floor.size, heights.shape[::-1], strict=True)
    )
    return textured(vertices, grid_faces(*grid.shape[:2]), np.column_stack([u, v]), floor.rgb)


def textured(vertices, faces, places, image: np.ndarray, **material: Any) -> "trimesh.Trimesh":
    """Return a surface with the colours of `image`, whose material does not reflect anything.

    `places` (V, 2): positions of the vertices in the image, from 0 to 1.
    """
    import trimesh  # takes long to load, and few pages need it
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    texture = Image.fromarray(np.ascontiguousarray(image[::-1]))
    matt = PBRMaterial(baseColorTexture=texture, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True, **material)
    return trimesh.Trimesh(vertices, faces, visual=TextureVisuals(uv=places, material=matt), process=False)


REPLACING_TIME = 3.0  # s that a surface stays beside the one that replaces it; `server/page.js` shows one of them

Part = Lines | Mesh | Floor | Surface


class SceneNodes:
    """Owns the nodes of one scene, which all pages share.

    `cameras`: places the cameras of the pages; `parts`: the primitives in the scene, by name.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # as the only light, it leaves colours unchanged
        self.parts: dict[str, Part] = {}
        self._handles: dict[str, Any] = {}
        self._labels = server.gui.add_html(content("labels"), visible=False)
        # The x of this node counts the changes of the texts: a page shows new texts when it has drawn the new x.
        self._labelled = server.scene.add_frame("/labelled", show_axes=False)
        self._texts = ""
        self._numbers = itertools.count()
        self._replaced: list[tuple[str, float | None, Any]] = []  # name, time of the replacement, s, and old node
        self.cameras = Cameras(server)

    def show(self, picture: Picture) -> None:
        """Make the scene look like `picture`."""
        parts: dict[str, Part] = {part.name: part for part in (*picture.lines, *picture.meshes)}
        parts |= {part.name: part for part in picture.surfaces}
        if picture.floor is not None:
            # No other node may have this name as a prefix, because viser would move it, too. A page keeps the position
            # of a node for the next node of the same name; a relief has no position and needs another name.
            parts["floor" if picture.floor.heights is None else "relief"] = picture.floor
        self.cameras.picture = picture
        texts = labels_html(picture.labels, picture.theme)
        with self._server.atomic():
            for name in sorted(self._handles.keys() - parts.keys(), reverse=True):  # a child before its parent
                self._handles.pop(name).remove()
            shown, self.parts = self.parts, parts
            self.remove_old()
            for name, part in parts.items():
                old = shown.get(name)
                if old is not part:
                    self._handles[name] = self._send(f"/{name}", old, self._handles.get(name), part)
            if texts != self._texts:
                count = int(self._labelled.position[0]) + 1
                self._texts, self._labelled.position = texts, (float(count), 0.0, 0.0)
                self._labels.content = content("labels", f"<i data-count='{count}'></i>{texts}")

    def remove_old(self, now: float | None = None) -> None:
        """Remove old surfaces that nothing replaces, and the others some time after new ones have replaced them.

        Otherwise a page would show no surface while it reads the new one. The main loop passes the time `now`, s.
        """
        kept = []
        for name, since, handle in self._replaced:
            due = now is not None and since is not None and since < now - REPLACING_TIME
            if due or name not in self.parts:
                handle.remove()
            else:
                kept.append((name, now if since is None else since, handle))
        self._replaced = kept

    def _send(self, name: str, old: Part | None, handle: Any, part: Part) -> Any:
        """Create the node of `part`, or update the one that shows `old`, and return its handle."""
        scene = self._server.scene
        if isinstance(part, Lines):
            if not isinstance(old, Lines) or (old.colour, old.width) != (part.colour, part.width):
                return scene.add_line_segments(
                    name, part.segments, part.colour, thickness=part.width, thickness_units="screen"
                )
            handle.points = part.segments
            return handle
        if isinstance(part, Surface):
            vertices, faces, places = part.vertices, part.faces, part.places
            return self._send_late(name, handle, textured(vertices, faces, places, part.texture, alphaMode="BLEND"))
        if isinstance(part, Floor):
            if part.heights is not None:
                return self._send_late(name, handle, relief_of(part, part.heights))
            if isinstance(old, Floor) and (old.origin, old.size, old.height) == (part.origin, part.size, part.height):
                handle.image = part.rgb
                return handle
            middle = np.add(part.origin, np.divide(part.size, 2))
            return scene.add_image(
                name, part.rgb, *part.size, format="png", cast_shadow=False, receive_shadow=False,
                wxyz=(1.0, 0.0, 0.0, 0.0), position=(*middle.tolist(), part.height),
            )  # fmt: skip
        same_style = isinstance(old, Mesh) and (old.colour, old.opacity) == (part.colour, part.opacity)
        if isinstance(old, Mesh) and same_style and np.array_equal(old.faces, part.faces):
            handle.vertices = part.vertices
            return handle
        return scene.add_mesh_simple(
            name, part.vertices, part.faces, color=part.colour, opacity=part.opacity if part.opacity < 1 else None,
            side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _send_late(self, name: str, handle: Any, surface: "trimesh.Trimesh") -> Any:
        """Create the node of a surface; the one that it replaces stays until pages have drawn the new one."""
        if handle is not None:
            self._replaced.append((name.removeprefix("/"), None, handle))
        name = f"{name}/{next(self._numbers)}"
        return self._server.scene.add_mesh_trimesh(name, surface, cast_shadow=False, receive_shadow=False)

    # The method below shows a scene before the first session is ready. This module does not import the solvers, so that
    # the page can show a picture while they are loaded.

    def show_room(self, request: OpenRequest, measurement: Measurement | None = None) -> None:
        """Show the microphones of a request, and the room if it is known; nothing if it must be simulated first.

        `measurement`: the measurement that was simulated for the request, if it was simulated.
        """
        if measurement is None:
            cached = request.measurement or load_cached_measurement(request.scene)
            if cached is None:
                return
            measurement = as_given(request.scene, cached)
        known_scene = None if isinstance(request.scene, MeasuredScene) else request.scene
        picture = static_picture(known_scene, measurement, request.choices.get("dark") is True)
        self.cameras.set_initial(picture)
        self.show(picture)
