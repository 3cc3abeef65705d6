"""[photographs] and [[cameras]]: targets to find in images, and prior knowledge of the cameras."""

from __future__ import annotations

import difflib
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from truing.schemas.section import Finite, Identifier, Name, NotNegative, Positive, Section, Shown

Parameter = Literal["c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2"]

# Published codes, and all possible codes.
_PUBLISHED = ("ring8", "ring12", "ring14")
RINGS = (*_PUBLISHED, *(f"{family}_any" for family in _PUBLISHED))
_ARUCO = tuple(f"aruco{bits}x{bits}_{codes}" for bits in (4, 5, 6, 7) for codes in (50, 100, 250, 1000))
MARKERS = (
    *(*_ARUCO, "aruco_original", "aruco_mip_36h12"),
    *("apriltag16h5", "apriltag25h9", "apriltag36h10", "apriltag36h11"),
)
FAMILIES = (*RINGS, *MARKERS)
# The smallest ArUco family of each size, because larger families repeat its codes.
USUAL = (*_PUBLISHED, "aruco4x4_50", "aruco5x5_100", "aruco6x6_250", "apriltag36h11")


def _known_family(family: str) -> str:
    if family not in FAMILIES:
        close = difflib.get_close_matches(family, FAMILIES, n=1)
        raise ValueError(f"did you mean {close[0]}?" if close else f"one of {', '.join(FAMILIES)}")
    return family


Family = Annotated[str, AfterValidator(_known_family)]
Corners = Annotated[int, Field(ge=2, le=200)]


class Board(Section):
    """[[photographs.boards]]: a chessboard, with or without markers in its white squares."""

    name: Shown = Field("", pattern=r"^[^/\s.]{0,60}$", description="prefix of its corners' names; absent: its kind")
    kind: Literal["chessboard", "charuco"] = Field(description="charuco: a marker in every white square")
    columns: Corners = Field(description="inner corners along x")
    rows: Corners = Field(description="inner corners along y")
    family: Family = Field("aruco4x4_50", description="charuco: family of the markers")
    first_code: int = Field(0, ge=0, description="charuco: code of the first marker")
    marker_share: float = Field(0.75, gt=0.2, lt=1.0, description="charuco: edge of a marker over that of a square")
    legacy: bool = Field(
        False, description="charuco: the pattern of OpenCV before 4.6, for an even number of rows of squares"
    )
    square_mm: Positive | None = Field(None, description="edge of a square; gives the scale if nothing else does")

    @model_validator(mode="after")
    def _check_distinguishable(self) -> Board:
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise ValueError(
                "one even and one odd number of columns and rows, because else it looks the same upside down"
            )
        if self.kind == "charuco" and self.family not in MARKERS:
            raise ValueError("a family of square markers")
        return self

    @property
    def label(self) -> str:
        """Prefix of its corners' names."""
        return self.name or self.kind


class Photographs(Section):
    """[photographs]: targets to find, and settings of the bundle adjustment."""

    targets: tuple[Family, ...] | None = Field(
        None,
        description='families of coded targets to look for, such as "ring12" or "apriltag36h11"; absent: those of the '
        f"table image_targets, else, where no boards are, {', '.join(USUAL)}",
    )
    boards: tuple[Board, ...] = Field((), description="boards to look for")
    uncoded: bool | None = Field(
        None,
        description="whether uncoded circles are measured and matched between images; absent: yes, unless only "
        "boards are searched for",
    )
    polarity: Literal["both", "white", "black"] = Field(
        "both", description="circular targets: lighter than their surroundings (white), darker (black), or both"
    )
    smallest_px: Positive = Field(2.5, description="circular targets: smallest semi-axis of the image")
    largest_px: Positive = Field(120.0, description="circular targets: largest semi-axis of the image")
    sensor_width_mm: Positive | None = Field(
        None, description="longer side of the sensor, if the photographs give only a focal length in mm"
    )
    target_mm: Positive | None = Field(
        None, description="diameter of circular targets without one in the table image_targets"
    )
    marker_mm: Positive | None = Field(
        None, description="edge of square markers without one in the table image_targets"
    )
    datum: Literal["free", "minimal", "known"] = Field(
        "free",
        description="datum of each pose: all its points (free), six coordinates (minimal), or the known points",
    )
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.001, description="probability that a good ray is rejected as a gross error"
    )
    variance_components: bool = Field(
        True, description="whether the noise of each camera and kind of target is estimated from the residuals"
    )
    eccentricity: bool = Field(True, description="whether image centres of circles are corrected for eccentricity")

    @model_validator(mode="after")
    def _check_distinguishable(self) -> Photographs:
        for family in set(self.targets or ()) & set(_PUBLISHED):
            if f"{family}_any" in (self.targets or ()):
                raise ValueError(f"{family} or {family}_any, not both, because one ring would have two codes")
        labels = [board.label for board in self.boards]
        if len(set(labels)) < len(labels):
            raise ValueError("different names for all boards")
        if self.largest_px <= self.smallest_px:
            raise ValueError("largest_px above smallest_px")
        return self


class GivenCamera(Section):
    """[[cameras]]: prior knowledge of a camera; x right, y down, the centre of the first pixel at 0."""

    name: Name = Field(description="name of the camera in photographs or rays")
    of: Name | None = Field(
        None,
        description="camera in photographs or rays that took some photographs that this entry separates as "
        "another camera",
    )
    poses: tuple[Identifier, ...] | None = Field(None, description="poses of these photographs; absent: all")
    images: tuple[Name, ...] | None = Field(None, description="names of these photographs; absent: all in these poses")
    width_px: int | None = Field(
        None, ge=1, le=1_000_000, description="pixels along x; absent: those of the photographs"
    )
    height_px: int | None = Field(None, ge=1, le=1_000_000, description="pixels along y")
    pixel_um: Positive | None = Field(None, description="pixel pitch")
    c_mm: Positive | None = Field(None, description="principal distance; needs pixel_um")
    focal_px: Positive | None = Field(None, description="principal distance in pixels")
    x0_px: Finite = Field(0.0, description="principal point along x, from the centre of the format")
    y0_px: Finite = Field(0.0, description="principal point along y, from the centre of the format")
    A1: Finite = Field(0.0, description="radial distortion, 1/px^2")
    A2: Finite = Field(0.0, description="radial distortion, 1/px^4")
    A3: Finite = Field(0.0, description="radial distortion, 1/px^6")
    B1: Finite = Field(0.0, description="decentring distortion, 1/px")
    B2: Finite = Field(0.0, description="decentring distortion, 1/px")
    C1: Finite = Field(0.0, description="affinity")
    C2: Finite = Field(0.0, description="shear")
    balancing_radius_px: NotNegative | None = Field(
        None, description="radius at which the radial distortion is zero; absent: a third of the format's diagonal"
    )
    free: tuple[Parameter, ...] | None = Field(None, description="parameters to estimate; absent: all ten")

    @model_validator(mode="after")
    def _group_of_photographs(self) -> GivenCamera:
        chosen = self.poses is not None or self.images is not None
        if chosen and self.of is None:
            raise ValueError('the key of with poses or images, for the camera of these photographs: of = "camera"')
        if self.of is not None and not chosen:
            raise ValueError("poses or images with the key of, for the photographs of this camera")
        if self.of == self.name:
            raise ValueError("a name other than that of the camera in of")
        return self

    @model_validator(mode="after")
    def _principal_distance_once(self) -> GivenCamera:
        if self.c_mm is not None and self.focal_px is not None:
            raise ValueError("c_mm or focal_px, not both")
        if self.c_mm is not None and self.pixel_um is None:
            raise ValueError("pixel_um with c_mm, or focal_px")
        return self
