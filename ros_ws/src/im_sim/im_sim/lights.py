"""The wrist lights by name."""

from im_core.errors import NotFoundError
from im_core.testbed_link import TestbedLink


class Lights:
    """Switches the lights of a testbed.

    Args:
        link: Where their state lives.
    """

    def __init__(self, link: TestbedLink) -> None:
        self._link = link

    def switch(self, name: str, on: bool) -> None:
        """Switch a light; exposures see it from the next tick on.

        Raises:
            NotFoundError: There is no light of that name.
        """
        names = self._link.light_names
        if name not in names:
            raise NotFoundError(kind="light", name=name, known=names)
        self._link.set_light(names.index(name), on)

    def state(self) -> dict[str, bool]:
        """Which lights are switched on."""
        return dict(zip(self._link.light_names, self._link.lights(), strict=True))
