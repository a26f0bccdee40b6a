"""What the three traverses do to the same street: light, weather, traffic and how the camera is mounted."""

from __future__ import annotations

from dataclasses import dataclass

from ..rendering.film import Colour


@dataclass(frozen=True)
class Weather:
    """One traverse's look; amounts are 0 to 256 unless a unit is named."""

    number: int  # tells the chance of one traverse from that of another
    sky_top: Colour
    sky_low: Colour
    cloud: Colour
    overcast: int  # mean cloud cover
    light: Colour  # multiplies every colour, in 1/256
    sunshine: int  # how much brighter the sunlit side is, and how dark shadows are
    grey: int  # how much of every colour's saturation is lost
    haze: int  # how much of a colour is lost at the far end of the view
    wet: int  # how much of what stands above it a road mirrors
    lit: int  # share of the windows with light in them
    lamps: int  # brightness of lamps and headlights
    foliage: int  # how full the trees are
    leaf: Colour
    drops: int  # most drops on the lens
    sensor: int  # noise, in 1/32
    softness: int  # how often the picture is blurred
    exposure: int  # gain of the camera
    parked: int  # how many of the places to park are taken
    busy: int  # how many vehicles and people are about
    shift_x: int  # heading of the camera, in 1/16 pixel
    shift_y: int
    lateral: int  # to the right of the other traverses, in units of the street


WEATHERS = {
    "sun": Weather(
        number=1, sky_top=(86, 136, 206), sky_low=(186, 210, 234), cloud=(246, 246, 246), overcast=40,
        light=(262, 254, 236), sunshine=90, grey=0, haze=60, wet=0, lit=0, lamps=0, foliage=256,
        leaf=(70, 106, 44), drops=0, sensor=1, softness=30, exposure=262, parked=115, busy=80,
        shift_x=8, shift_y=-3, lateral=3,
    ),
    "rain": Weather(
        number=2, sky_top=(150, 156, 164), sky_low=(184, 188, 192), cloud=(170, 174, 178), overcast=230,
        light=(176, 184, 192), sunshine=0, grey=120, haze=150, wet=130, lit=26, lamps=110, foliage=150,
        leaf=(132, 112, 56), drops=14, sensor=2, softness=120, exposure=250, parked=125, busy=70,
        shift_x=-7, shift_y=4, lateral=-4,
    ),
    "dusk": Weather(
        number=3, sky_top=(46, 58, 92), sky_low=(150, 116, 106), cloud=(66, 66, 88), overcast=130,
        light=(112, 110, 132), sunshine=0, grey=60, haze=100, wet=0, lit=44, lamps=256, foliage=40,
        leaf=(104, 88, 60), drops=0, sensor=3, softness=90, exposure=268, parked=105, busy=80,
        shift_x=3, shift_y=-2, lateral=3,
    ),
}  # fmt: skip
