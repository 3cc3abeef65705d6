"""[photographs] and [[cameras]]: what to look for in images, and what is known of the cameras."""

from __future__ import annotations

import difflib
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from truing.schemas.section import Finite, Identifier, Name, NotNegative, Positive, Section, Shown

Parameter = Literal["c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2"]

# As published, and with every word there is.
_PUBLISHED = ("ring8", "ring12", "ring14")
RINGS = (*_PUBLISHED, *(f"{family}_any" for family in _PUBLISHED))
_ARUCO = tuple(f"aruco{bits}x{bits}_{codes}" for bits in (4, 5, 6, 7) for codes in (50, 100, 250, 1000))
MARKERS = (
    *(*_ARUCO, "aruco_original", "aruco_mip_36h12"),
    *("apriltag16h5", "apriltag25h9", "apriltag36h10", "apriltag36h11"),
)
FAMILIES = (*RINGS, *MARKERS)
# Of ArUco the smallest family of each size: a larger one repeats its codes.
USUAL = (*_PUBLISHED, "aruco4x4_50", "aruco5x5_100", "aruco6x6_250", "apriltag36h11")


def _known(family: str) -> str:
    if family not in FAMILIES:
        close = difflib.get_close_matches(family, FAMILIES, n=1)
        raise ValueError(f"did you mean {close[0]}?" if close else f"one of {', '.join(FAMILIES)}")
    return family


Family = Annotated[str, AfterValidator(_known)]
Corners = Annotated[int, Field(ge=2, le=200)]


class Board(Section):
    """[[photographs.boards]]: a chessboard, or one with markers in its white squares."""

    name: Shown = Field("", pattern=r"^[^/\s.]{0,60}$", description="names its corners; absent: its kind does")
    kind: Literal["chessboard", "charuco"] = Field(description="charuco: a marker in every white square")
    columns: Corners = Field(description="inner corners along x")
    rows: Corners = Field(description="inner corners along y")
    family: Family = Field("aruco4x4_50", description="charuco: the markers' family")
    first_code: int = Field(0, ge=0, description="charuco: the code of the first marker")
    marker_share: float = Field(0.75, gt=0.2, lt=1.0, description="charuco: edge of a marker over that of a square")
    legacy: bool = Field(False, description="charuco: the pattern of OpenCV before 4.6, where rows are odd")
    square_mm: Positive | None = Field(None, description="edge of a square: gives the scale where nothing else does")

    @model_validator(mode="after")
    def _is_distinguishable(self) -> Board:
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise ValueError("one even and one odd number of columns and rows: else it looks the same upside down")
        if self.kind == "charuco" and self.family not in MARKERS:
            raise ValueError("a family of square markers")
        return self

    @property
    def label(self) -> str:
        """What its corners are named by."""
        return self.name or self.kind


class Photographs(Section):
    """[photographs]: the targets to look for, and how the network of rays is adjusted."""

    targets: tuple[Family, ...] | None = Field(
        None,
        description='families of coded targets to look for, such as "ring12" or "apriltag36h11"; absent: those of the '
        f"table image_targets, else, where no boards are, {', '.join(USUAL)}",
    )
    boards: tuple[Board, ...] = Field((), description="boards to look for")
    uncoded: bool | None = Field(
        None,
        description="whether circles without a code are measured and matched over images; absent: yes, unless boards "
        "alone are looked for",
    )
    polarity: Literal["both", "white", "black"] = Field(
        "both", description="circular targets: lighter than what surrounds them (white), darker (black), or both"
    )
    smallest_px: Positive = Field(2.5, description="circular targets: least half axis of the image of one")
    largest_px: Positive = Field(120.0, description="circular targets: largest half axis of the image of one")
    sensor_width_mm: Positive | None = Field(
        None, description="the longer side of the sensor, where photographs tell a focal length in mm alone"
    )
    target_mm: Positive | None = Field(
        None, description="diameter of circular targets that the table image_targets gives none"
    )
    marker_mm: Positive | None = Field(
        None, description="edge of square markers that the table image_targets gives none"
    )
    datum: Literal["free", "minimal", "known"] = Field(
        "free",
        description="what the frame of each pose rests on: all its points, six coordinates, or the known points",
    )
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.001, description="probability of a good ray to be rejected as a gross error"
    )
    variance_components: bool = Field(
        True, description="whether the noise of each camera and kind of target is estimated from the residuals"
    )
    eccentricity: bool = Field(True, description="whether the centres of circles' images are brought to their circles'")

    @model_validator(mode="after")
    def _is_distinguishable(self) -> Photographs:
        for family in set(self.targets or ()) & set(_PUBLISHED):
            if f"{family}_any" in (self.targets or ()):
                raise ValueError(f"{family} or {family}_any, not both: one ring would have two numbers")
        labels = [board.label for board in self.boards]
        if len(set(labels)) < len(labels):
            raise ValueError("boards with a name each: several have the same one")
        if self.largest_px <= self.smallest_px:
            raise ValueError("largest_px above smallest_px")
        return self


class GivenCamera(Section):
    """[[cameras]]: what is known of a camera beforehand; x right, y down, the middle of the first pixel at 0."""

    name: Name = Field(description="the camera, as photographs or rays name it")
    of: Name | None = Field(
        None, description="the camera as photographs or rays name it, of which some photographs count as by this one"
    )
    poses: tuple[Identifier, ...] | None = Field(None, description="the poses of these photographs; absent: all")
    images: tuple[Name, ...] | None = Field(None, description="these photographs; absent: all in these poses")
    width_px: int | None = Field(
        None, ge=1, le=1_000_000, description="pixels along x; absent: as the photographs have"
    )
    height_px: int | None = Field(None, ge=1, le=1_000_000, description="pixels along y")
    pixel_um: Positive | None = Field(None, description="pitch of the pixels")
    c_mm: Positive | None = Field(None, description="principal distance; needs pixel_um")
    focal_px: Positive | None = Field(None, description="the same in pixels")
    x0_px: Finite = Field(0.0, description="principal point from the middle of the format")
    y0_px: Finite = Field(0.0, description="the same along y")
    A1: Finite = Field(0.0, description="radial distortion, 1/px^2")
    A2: Finite = Field(0.0, description="radial distortion, 1/px^4")
    A3: Finite = Field(0.0, description="radial distortion, 1/px^6")
    B1: Finite = Field(0.0, description="decentring distortion, 1/px")
    B2: Finite = Field(0.0, description="decentring distortion, 1/px")
    C1: Finite = Field(0.0, description="affinity")
    C2: Finite = Field(0.0, description="shear")
    balancing_radius_px: NotNegative | None = Field(
        None, description="where the radial distortion is zero; absent: a third of the format's diagonal"
    )
    free: tuple[Parameter, ...] | None = Field(None, description="parameters to estimate; absent: all ten")

    @model_validator(mode="after")
    def _group_of_photographs(self) -> GivenCamera:
        chosen = self.poses is not None or self.images is not None
        if chosen and self.of is None:
            raise ValueError('of, the camera whose photographs these are, beside poses or images: of = "camera"')
        if self.of is not None and not chosen:
            raise ValueError("poses or images beside of: which photographs count as by this camera")
        if self.of == self.name:
            raise ValueError("a name other than that of the camera in of")
        return self

    @model_validator(mode="after")
    def _principal_distance_once(self) -> GivenCamera:
        if self.c_mm is not None and self.focal_px is not None:
            raise ValueError("c_mm or focal_px, not both")
        if self.c_mm is not None and self.pixel_um is None:
            raise ValueError("pixel_um beside c_mm, or focal_px")
        return self
