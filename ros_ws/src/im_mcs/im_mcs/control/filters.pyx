# Filters of encoders and errors, compiled; filters.pyi has the interface and what it means.
from libc.math cimport copysign, exp, fabs, isfinite, llround

import numpy as np

cimport numpy as cnp

cnp.import_array()


cdef object _vector(Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_FLOAT64, 0)


cdef double* _data(object array, Py_ssize_t n) except NULL:
    if not (cnp.PyArray_Check(array) and cnp.PyArray_TYPE(array) == cnp.NPY_FLOAT64 and cnp.PyArray_SIZE(array) == n):
        raise ValueError(f"no array of {n} floats")
    if not cnp.PyArray_IS_C_CONTIGUOUS(array):
        raise ValueError("an array is not in a row")
    return <double*>cnp.PyArray_DATA(array)


cdef double _beyond(double x, double band):
    """Part of a number beyond a dead band."""
    cdef double low = -band if x < -band else x
    return x - (band if low > band else low)


cdef class VelocityEstimator:
    cdef Py_ssize_t n
    cdef long long _period_ns
    cdef double _bandwidth, _gain, _decay
    cdef object _last, _value, _times

    def __init__(self, n, period_s, bandwidth_rad_s):
        self.n = n
        self._period_ns = llround(1e9 * period_s)
        self._bandwidth = bandwidth_rad_s
        self._gain = (1.0 - exp(-bandwidth_rad_s * period_s)) / period_s
        self._decay = exp(-bandwidth_rad_s * period_s)
        self.reset()

    cpdef reset(self):
        self._last, self._value, self._times = None, np.zeros(self.n), None

    cpdef update(self, x):
        cdef Py_ssize_t i
        cdef double *new = _data(x, self.n)
        cdef double *last
        cdef double *before
        cdef double *value
        cdef object found
        if self._last is not None:
            found = _vector(self.n)
            last, before, value = _data(self._last, self.n), _data(self._value, self.n), _data(found, self.n)
            for i in range(self.n):
                value[i] = self._filtered(before[i], new[i], last[i], self._decay, self._gain)
            self._value = found
        self._last = x
        return self._value

    cpdef update_at(self, x, long long stamp_ns, age_s):
        cdef Py_ssize_t i
        cdef double *new = _data(x, self.n)
        cdef double *age = _data(age_s, self.n)
        cdef double *last
        cdef double *before
        cdef double *value
        cdef object found
        cdef double decay, dt
        cdef long long taken, elapsed
        cdef long long[::1] times
        if self._last is None:
            self._last, self._times = x.copy(), np.full(self.n, stamp_ns)
            times = self._times
            for i in range(self.n):
                if isfinite(age[i]):
                    times[i] = stamp_ns - llround(1e9 * age[i])
            return self._value
        times, found = self._times, _vector(self.n)
        last, before, value = _data(self._last, self.n), _data(self._value, self.n), _data(found, self.n)
        for i in range(self.n):
            taken = stamp_ns - llround(1e9 * age[i]) if isfinite(age[i]) else stamp_ns
            elapsed = taken - times[i]
            if 2 * elapsed < self._period_ns:
                value[i] = before[i]
                continue
            if elapsed == self._period_ns:
                value[i] = self._filtered(before[i], new[i], last[i], self._decay, self._gain)
            else:
                dt = 1e-9 * elapsed
                decay = exp(-self._bandwidth * dt)
                value[i] = self._filtered(before[i], new[i], last[i], decay, (1.0 - decay) / dt)
            last[i], times[i] = new[i], taken
        self._value = found
        return found

    cdef double _filtered(self, double before, double new, double last, double decay, double gain):
        cdef double value = decay * before + gain * (new - last)
        # else what is not a number would stay for good
        return 0.0 if not isfinite(value) and isfinite(new) else value


cdef class ErrorFeedback:
    cdef Py_ssize_t n
    cdef double _smoothing, _rest_band
    cdef object _kp, _kd, _ki_dt, _integral_limit, _error, _integral
    cdef readonly object deadband, smooth_error
    cdef readonly bint holding
    cdef VelocityEstimator _rate

    def __init__(self, kp, kd, ki_dt, integral_limit, smoothing, deadband, rest_deadband, rate):
        self.n = len(kp)
        self._kp, self._kd, self._ki_dt, self._integral_limit = kp, kd, ki_dt, integral_limit
        self._smoothing, self._rest_band = smoothing, rest_deadband
        self.deadband = np.full(self.n, deadband)
        self._rate = rate
        self.reset()

    cpdef reset(self):
        self._rate.reset()
        self._error = self._integral = self.smooth_error = np.zeros(self.n)
        self.holding = False

    cpdef hold(self, bint hold):
        self.holding = hold

    def update(self, error):
        cdef Py_ssize_t i, n = self.n
        cdef double *e = _data(error, n)
        cdef double *smooth = _data(self.smooth_error, n)
        cdef double *kp = _data(self._kp, n)
        cdef double *kd = _data(self._kd, n)
        cdef double *integral = _data(self._integral, n)
        cdef double *rate
        cdef double *target
        cdef double *answer
        cdef object made = _vector(n), answers
        target = _data(made, n)
        if self.holding:
            for i in range(n):
                target[i] = smooth[i] + _beyond(e[i] - smooth[i], self._rest_band)
            error, e = made, target
        else:
            for i in range(n):
                target[i] = smooth[i] + self._smoothing * (e[i] - smooth[i])
            self.smooth_error = made
        self._error = error
        answers = _vector(n)
        answer = _data(answers, n)
        made = self._rate.update(error)
        rate = _data(made, n)
        for i in range(n):
            answer[i] = (kp[i] * e[i] + kd[i] * rate[i]) + integral[i]
        return answers

    def integrate(self, tau, torque_limit):
        cdef Py_ssize_t i, n = self.n
        cdef double *torque
        cdef double *most
        cdef double *e
        cdef double *ki_dt
        cdef double *bound
        cdef double *band
        cdef double *before
        cdef double *integral
        cdef double step, value
        cdef object made
        if self.holding:
            return
        torque, most, e, ki_dt = _data(tau, n), _data(torque_limit, n), _data(self._error, n), _data(self._ki_dt, n)
        bound, band, before = _data(self._integral_limit, n), _data(self.deadband, n), _data(self._integral, n)
        made = _vector(n)
        integral = _data(made, n)
        for i in range(n):
            step = ki_dt[i] * _beyond(e[i], band[i])
            if not fabs(torque[i]) < most[i] and not torque[i] * e[i] < 0.0:
                step = 0.0
            value = before[i] + step
            value = -bound[i] if value < -bound[i] else value
            integral[i] = bound[i] if value > bound[i] else value
        self._integral = made


def friction_torque(
    v, turns, double share, double stiction, positive, negative, viscous, ErrorFeedback pushed=None, bint creeping=False
):
    cdef Py_ssize_t i, n = len(v)
    cdef object torques = _vector(n)
    cdef double *torque = _data(torques, n)
    cdef double *speed = _data(v, n)
    cdef double *turn = _data(turns, n)
    cdef double *forwards = _data(positive, n)
    cdef double *backwards = _data(negative, n)
    cdef double *damping = _data(viscous, n)
    cdef double *error = NULL
    cdef double *band = NULL
    cdef double direction, push
    if pushed is not None and not pushed.holding:
        error, band = _data(pushed.smooth_error, n), _data(pushed.deadband, n)
    for i in range(n):
        direction = share * turn[i]
        if error is not NULL and (creeping or speed[i] == 0.0):
            push = fabs(error[i]) / band[i] - 1.0
            push = stiction * copysign(0.0 if push < 0.0 else 1.0 if push > 1.0 else push, error[i])
            direction = push if speed[i] == 0.0 else direction + (1.0 - fabs(turn[i])) * push
        torque[i] = (forwards[i] if direction > 0.0 else backwards[i]) * direction + damping[i] * speed[i]
    return torques


def model_torque(double gravity_share, gravity, friction, double inertia_share, inertia, a):
    cdef Py_ssize_t i, n = len(gravity)
    cdef object torques = _vector(n)
    cdef double *torque = _data(torques, n)
    cdef double *weight = _data(gravity, n)
    cdef double *loss = _data(friction, n)
    cdef double *own
    cdef const double[:] acceleration
    for i in range(n):
        torque[i] = gravity_share * weight[i] + loss[i]
    if inertia is not None:
        own, acceleration = _data(inertia, n), a
        if acceleration.shape[0] != n:
            raise ValueError(f"{acceleration.shape[0]} accelerations are given for {n} joints")
        for i in range(n):
            torque[i] = torque[i] + inertia_share * own[i] * acceleration[i]
    return torques
