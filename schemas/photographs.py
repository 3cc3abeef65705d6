"""[photographs] and [[cameras]]: what to look for in images, and what is known of the cameras."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.section import Finite, NotNegative, Positive, Section

Parameter = Literal["c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2"]


class Photographs(Section):
    """[photographs]: the targets to look for, and how the network of rays is adjusted."""

    targets: tuple[str, ...] = Field(
        (), description='families of coded targets to look for, such as "ring12" or "apriltag36h11"; absent: all rings'
    )
    uncoded: bool = Field(True, description="whether circles without a code are measured and matched over images")
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


class GivenCamera(Section):
    """[[cameras]]: what is known of a camera beforehand; x right, y down, the middle of the first pixel at 0."""

    name: str = Field(min_length=1, description="the camera, as photographs or rays name it")
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
    def _principal_distance_once(self) -> GivenCamera:
        if self.c_mm is not None and self.focal_px is not None:
            raise ValueError("c_mm or focal_px, not both")
        if self.c_mm is not None and self.pixel_um is None:
            raise ValueError("pixel_um beside c_mm, or focal_px")
        return self
