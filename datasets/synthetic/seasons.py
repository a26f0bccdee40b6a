"""What the four seasons do to the same route: colours, foliage, snow, light, weather and the camera."""

from __future__ import annotations

from dataclasses import dataclass

from .chance import Ints
from .film import Colour


@dataclass(frozen=True)
class Season:
    """One traverse's look; amounts are 0 to 256 unless a unit is named."""

    number: int  # tells the chance of one traverse from that of another
    grass: Colour
    field: Colour
    heath: Colour
    conifer: Colour
    leaf: Colour
    water: Colour
    sky_top: Colour
    sky_low: Colour
    cloud: Colour
    light: Colour  # multiplies every colour, in 1/256
    foliage: int  # how full the broadleaved crowns are
    snow: int  # cover in the lowlands
    snow_uphill: int  # cover added in the highest parts
    overcast: int  # mean cloud cover
    stratus: int  # how far a closed cover is one grey
    sunshine: int  # how much brighter the sunlit side is at most
    haze: int  # how much of a colour is lost at the far end of the view
    exposure: int  # gain of the camera
    regrown: int  # how far the outline of the woods is another than in summer
    astray: int  # metres that its frames are spread over around their place
    softness: int  # how often and how far the picture is blurred
    shift_x: int  # mounting of the camera, in 1/16 pixel
    shift_y: int


@dataclass(frozen=True)
class SnowCover:
    """What the snow hides at each cross-section (n,) of one frame, 0 to 256."""

    land: Ints
    line: Ints  # rails apart
    woods: Ints  # on the trees: none where little has fallen


SEASONS = {
    "spring": Season(
        number=1, grass=(112, 112, 70), field=(128, 104, 76), heath=(116, 98, 70), conifer=(46, 64, 44),
        leaf=(126, 138, 80), water=(96, 118, 138), sky_top=(112, 154, 204), sky_low=(196, 212, 224),
        cloud=(236, 238, 240), light=(248, 250, 252), foliage=130, snow=0, snow_uphill=160, overcast=140, stratus=20,
        sunshine=40, haze=90, exposure=250, regrown=10, astray=2, softness=60, shift_x=-14, shift_y=6,
    ),
    "summer": Season(
        number=2, grass=(72, 100, 46), field=(104, 122, 58), heath=(88, 100, 58), conifer=(44, 66, 40),
        leaf=(66, 108, 44), water=(74, 106, 134), sky_top=(84, 138, 206), sky_low=(178, 204, 228),
        cloud=(244, 244, 244), light=(256, 252, 240), foliage=256, snow=0, snow_uphill=0, overcast=130, stratus=40,
        sunshine=56, haze=110, exposure=256, regrown=0, astray=2, softness=20, shift_x=4, shift_y=-4,
    ),
    "fall": Season(
        number=3, grass=(118, 104, 60), field=(150, 126, 74), heath=(134, 82, 50), conifer=(44, 60, 40),
        leaf=(196, 134, 44), water=(84, 100, 116), sky_top=(136, 152, 172), sky_low=(204, 204, 200),
        cloud=(214, 212, 210), light=(256, 240, 216), foliage=190, snow=0, snow_uphill=60, overcast=180, stratus=40,
        sunshine=40, haze=130, exposure=236, regrown=10, astray=2, softness=110, shift_x=2, shift_y=2,
    ),
    "winter": Season(
        number=4, grass=(130, 122, 96), field=(126, 112, 90), heath=(112, 100, 84), conifer=(48, 58, 52),
        leaf=(104, 94, 88), water=(196, 206, 216), sky_top=(158, 172, 194), sky_low=(206, 212, 222),
        cloud=(222, 224, 228), light=(226, 238, 256), foliage=0, snow=225, snow_uphill=60, overcast=180, stratus=128,
        sunshine=25, haze=170, exposure=240, regrown=40, astray=8, softness=90, shift_x=-6, shift_y=-12,
    ),
}  # fmt: skip
