# Setpoints within limits, and the way to rest, compiled; braking.pyi has the interface and what it means.
from libc.math cimport copysign, fabs, sqrt

import numpy as np

cimport numpy as cnp

cnp.import_array()

cdef double _TINY = 1e-12


cdef object _vector(Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_FLOAT64, 0)


cpdef double stopping_place(double q, double v, double a, double most, double jerk):
    cdef double ramp = fabs(a) / jerk, gain = a * ramp / 2.0
    cdef double coasting = v + gain, braked
    if coasting * a < 0.0:
        braked = fabs(v - gain) * ramp - jerk * ramp**3 / 6.0
        return q + copysign(_distance(fabs(v - gain), most, jerk) - braked, v)
    return q + v * ramp + a * ramp**2 / 3.0 + copysign(_distance(fabs(coasting), most, jerk), coasting)


cdef double _distance(double speed, double most, double jerk):
    """Way from a speed >= 0 without acceleration to rest."""
    if speed < most**2 / jerk:
        return speed * sqrt(speed / jerk)
    return speed**2 / (2.0 * most) + speed * most / (2.0 * jerk)


cpdef double way_to_rest(double speed, double forward, double most, double jerk):
    cdef double t, peak, passed, ramp = most / jerk
    # the profile from constant velocity `peak` that passes through the present state
    if forward >= 0.0:
        t = forward / jerk
        peak = speed + 0.5 * forward * t
        passed = -t * (speed + forward * t / 3.0)
    else:
        forward = min(-forward, sqrt(2.0 * jerk * speed))
        t = forward / jerk
        peak = speed + 0.5 * forward * t
        passed = t * (peak - forward * t / 6.0)
    return peak * (sqrt(peak / jerk) if peak < most * ramp else 0.5 * (peak / most + ramp)) - passed


def flags_within(
    const double[:, ::1] wanted, const double[:, ::1] last, double dt, const double[:, ::1] bounds,
    const double[:, ::1] slopes, const double[:, ::1] ends, const double[:, ::1] hardest,
):
    cdef Py_ssize_t i, k, n = wanted.shape[1]
    cdef cnp.ndarray flags
    cdef unsigned char *flag
    cdef double[6] row
    cdef double rest, lower, upper
    cdef bint fine = True
    cdef cnp.npy_intp[2] shape
    shape[0], shape[1] = 6, n
    flags = cnp.PyArray_EMPTY(2, shape, cnp.NPY_BOOL, 0)
    flag = <unsigned char*>cnp.PyArray_DATA(flags)
    for i in range(n):
        row[0] = fabs(wanted[0, i] - (last[0, i] + dt * last[1, i] + dt * dt / 2.0 * last[2, i]))
        row[1] = fabs(wanted[1, i] - (last[1, i] + dt * last[2, i]))
        row[2] = fabs(wanted[2, i] - last[2, i])
        row[3], row[4] = fabs(wanted[1, i]), fabs(wanted[2, i])
        row[5] = fabs(wanted[0, i] - (ends[0, i] + ends[1, i]) / 2.0) + (slopes[0, i] * row[3] + slopes[1, i] * row[4])
        for k in range(6):
            flag[k * n + i] = row[k] <= bounds[k, i]  # what is not a number is never within
        if not flag[5 * n + i]:  # then only looking closer tells
            rest = stopping_place(wanted[0, i], wanted[1, i], wanted[2, i], hardest[0, i], hardest[1, i])
            lower, upper = min(ends[0, i], last[0, i]), max(ends[1, i], last[0, i])
            flag[5 * n + i] = min(wanted[0, i], rest) >= lower and max(wanted[0, i], rest) <= upper
        for k in range(6):
            fine = fine and flag[k * n + i]
    return None if fine else flags


cdef class BrakingGroup:
    cdef readonly object index, place
    cdef double[::1] _acceleration, _jerk, _slowness, _softness, _weight
    cdef double _across, _reaction

    def __init__(self, velocity, acceleration, jerk, index, place, across, reaction_s):
        self.index, self.place = index, place
        self._acceleration, self._jerk = np.array(acceleration, dtype=np.float64), np.array(jerk, dtype=np.float64)
        self._slowness, self._softness = 1.0 / np.asarray(self._acceleration), 1.0 / np.asarray(self._jerk)
        self._weight = np.array(velocity, dtype=np.float64) ** -2.0
        self._across, self._reaction = across, reaction_s

    def displacement(self, const double[::1] v, const double[::1] a):
        cdef Py_ssize_t i, n = v.shape[0]
        cdef double forward = self.forward(v, a), gain, share
        cdef object ways
        cdef double *way
        for i in range(n):
            if not fabs(a[i] - forward * v[i]) <= self._across * self._acceleration[i]:
                return self.apart(v, a)
        # straight on: in proportion, no joint needs more way alone than together with the others
        gain = 1.0 + self._reaction * forward
        if fabs(gain) < 1.0:
            gain = 1.0
        share = gain * (self.seconds(v, forward / gain, gain) + self._reaction)
        ways = _vector(n)
        way = <double*>cnp.PyArray_DATA(ways)
        for i in range(n):
            way[i] = v[i] * share
        return ways

    def seconds_on_path(self, const double[::1] v, const double[::1] a):
        return self.seconds(v, self.forward(v, a), 1.0)

    cdef apart(self, const double[::1] v, const double[::1] a):
        """Way of joints with accelerations off the motion: each alone, and together."""
        cdef Py_ssize_t i, n = v.shape[0]
        cdef object ways = _vector(n), speeds = _vector(n)
        cdef double[::1] speed = speeds
        cdef double *way = <double*>cnp.PyArray_DATA(ways)
        cdef double later, shared, alone, size
        for i in range(n):  # a motion that speeds up does so until it brakes
            later = v[i] + self._reaction * a[i]
            speed[i] = later if fabs(later) > fabs(v[i]) else v[i]
        shared = self.seconds(speed, self.forward(speed, a), 1.0)
        for i in range(n):
            size = fabs(speed[i])
            alone = way_to_rest(size, copysign(a[i], a[i] * speed[i]), self._acceleration[i], self._jerk[i])
            alone = max(alone, shared * size) + self._reaction * size
            way[i] = alone if speed[i] > 0.0 else -alone if speed[i] < 0.0 else 0.0
        return ways

    cdef double forward(self, const double[::1] v, const double[::1] a):
        """Acceleration along the motion, as a multiple of the velocities."""
        cdef Py_ssize_t i
        cdef double along = 0.0, size = 0.0
        for i in range(v.shape[0]):
            along += self._weight[i] * v[i] * a[i]
            size += self._weight[i] * v[i] * v[i]
        return along / max(size, _TINY)

    cdef double seconds(self, const double[::1] v, double forward, double gain):
        """Way until rest of the joints together, in seconds at ``gain`` times the velocities ``v``."""
        cdef Py_ssize_t i
        cdef double acceleration = 0.0, jerk = 0.0
        for i in range(v.shape[0]):
            acceleration = max(acceleration, self._slowness[i] * fabs(v[i]))
            jerk = max(jerk, self._softness[i] * fabs(v[i]))
        return way_to_rest(1.0, forward, 1.0 / max(gain * acceleration, _TINY), 1.0 / max(gain * jerk, _TINY))
