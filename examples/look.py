"""Take an image with the light of an arm off and on, and find the light in it.

In a notebook, `camera.snap()` shows the image.
"""

from im import Machine, MachineError

with Machine.connect() as im:
    camera = im.camera("ceiling_left")
    dark = camera.snap()
    print(f"{dark.shape[1]} x {dark.shape[0]} pixels, {dark.mean():.1f} on average")
    with im.light("left_led"):
        spot = camera.spot()
        print("light at", spot.uv.round(2), "px, known to", (spot.covariance.diagonal() ** 0.5).round(3))
    try:
        camera.spot()
    except MachineError as error:
        print(f"{error.code}: {error}")
