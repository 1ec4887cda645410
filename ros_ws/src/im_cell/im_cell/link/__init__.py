"""The link between the testbed's physics, the servo loop and the cameras: shared memory ``/<instance>_testbed``.

It is a stand-in for the wires of a real robot: encoder readings one way, torques the other, and an exposure trigger for
the cameras. The physics process creates the link as :class:`HostEnd`; everybody else attaches an end that can do what
its user may do and no more: :class:`ServoEnd`, :class:`CameraEnd`, :class:`RateEnd` (images that come by
themselves), :class:`LaserEnd`, :class:`PanelEnd` (lights, faults, objects between the jaws), :class:`StopEnd`
(emergency stop), :class:`ClockEnd` (time only). Truth is to be had at the host's end alone.

One tick, period 4.5 ms, is one handshake::

    physics                                        servo (im_mcs.servo)
    -------                                        --------------------
    while factor == 0 and no demand: sleep         while not end.wait_state(timeout_s=0.2):
    publish_state(tick k), post state    ------>       (nothing to do yet; look after oneself)
    what no command changes                        state = end.read_state()          # tick k
    await_command()                      <------   end.write_command(command)
    four substeps
    tick = k + 1, its state is readable

*Pace.* ``factor > 0``: with a servo attached the servo paces, i.e. it sleeps to its own absolute deadline
(``wall_period_s`` apart) between ``wait_state`` and ``write_command``; alone, physics paces itself.
``factor == 0``: a tick starts only while somebody wants time: the servo's last command said ``wants_time``, a client
asked by ``request_time(ticks)``, or an exposure is pending. A client that first sends its message to the servo
and then calls ``request_time(1)`` is therefore heard at a tick that does not depend on anybody's speed.

*Watchdog.* A servo that does not answer a tick within 0.5 s of wall time (0.05 s while the stop circuit is cut), or
dies, is declared gone: power off, brakes on, physics goes on alone, at clock factor 0 until the arms rest. A servo
that comes back late gets a :class:`~im_core.errors.LinkError` from ``wait_state`` or ``write_command`` and must
``attach_servo`` again. When physics is gone, ``wait_state``, ``expose`` and ``wait_tick`` raise the same error, and
one attaches anew.

*Brakes.* ``brakes[i]`` true: the joint is held, a stated delay later. Without power all torques are zero and all
brakes are told to hold, against any command; ``Measured.power`` and ``Measured.brakes`` have the true state.

*Emergency stop.* ``cut`` at the :class:`StopEnd` is as if the servo commanded no power, until ``restore``; it needs no
servo.

*Grippers.* Openings in metres, forces in newtons: the command says where to go and with what force at most, the state
where the jaws are and what they press with.

*Exposures.* ``expose(ticks, blank_light, timeout_s, blank_laser)`` starts at the next tick boundary and takes ``ticks``
ticks; ``blank_light`` strobes the wrist lights off during it, ``blank_laser`` the laser. One client at a time; a new
client replaces a dead one. ``await_image(due_ns)`` at the :class:`RateEnd`: at ``factor == 0`` time that others want
waits there until the image is taken and the next one is announced, for a second at most.

*Laser.* ``set_laser`` says where the mirrors of the scanner shall go and with what power the beam shall be lit; they
move at their own rate, ``laser`` says where they are. The end asks for the time that takes.

*Disturbances.* ``set_faults``, ``stall`` and ``set_object`` break the testbed and put things between its jaws, from the
next tick on: to test what stands above it. ``place`` puts a free body of the cell somewhere, ``bodies`` says where
all are.
"""

from im_cell.link.end import ClockEnd, StopEnd
from im_cell.link.host import HostEnd
from im_cell.link.panel import PanelEnd
from im_cell.link.servo import ServoEnd
from im_cell.link.values import (
    ControlState,
    Drive,
    Exposure,
    ExposureRequest,
    Faults,
    JawObject,
    LaserBeam,
    Measured,
    Sensors,
    TrueState,
)
from im_cell.link.vision import CameraEnd, LaserEnd, RateEnd

__all__ = [
    "CameraEnd",
    "ClockEnd",
    "ControlState",
    "Drive",
    "Exposure",
    "ExposureRequest",
    "Faults",
    "HostEnd",
    "JawObject",
    "LaserBeam",
    "LaserEnd",
    "Measured",
    "PanelEnd",
    "RateEnd",
    "Sensors",
    "ServoEnd",
    "StopEnd",
    "TrueState",
]
