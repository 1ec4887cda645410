# Motors, gears and friction, compiled; actuators.pyi has the interface and what it means.
#
# All sums are in the order of the equations, without fused multiply-add (scripts/compile_steps.py): a run is the same to
# the last digit on every computer. Matrices are multiplied and factorised by numpy and Eigen, a call each.
from libc.math cimport fabs, isfinite, INFINITY
from libc.string cimport memcpy

import eigenpy
import numpy as np
import pinocchio as pin

cimport numpy as cnp

cnp.import_array()

cdef int _MAX_PIVOTS = 1000
# After so many block pivots that make nothing better, one joint is turned at a time until something is: block pivots
# can go round in circles, single ones (K.G. Murty, 1974) cannot.
cdef int _BLOCKS_IN_VAIN = 4


cdef double* _data(object array, Py_ssize_t n) except NULL:
    """Numbers of an array of shape (n,), or of n numbers."""
    if not cnp.PyArray_Check(array) or cnp.PyArray_TYPE(array) != cnp.NPY_FLOAT64:
        raise TypeError(f"{type(array).__name__} is no array of floats")
    if cnp.PyArray_SIZE(array) != n or not (cnp.PyArray_IS_C_CONTIGUOUS(array) or cnp.PyArray_IS_F_CONTIGUOUS(array)):
        raise ValueError(f"an array has {cnp.PyArray_SIZE(array)} numbers, not {n} in a row")
    return <double*>cnp.PyArray_DATA(array)


cdef object _vector(Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_FLOAT64, 0)


cdef object _floats(object values):
    return np.array(values, dtype=np.float64)


cdef class DryFriction:
    cdef readonly bint stuck, all_slip
    cdef readonly object impulse
    cdef Py_ssize_t n
    cdef object _cholesky, _matrix, _factorised
    cdef object _arrays
    cdef double *_sign
    cdef double *_least
    cdef double *_most
    cdef double *_lower
    cdef double *_upper
    cdef double *_impulse
    cdef double *_slips

    def __init__(self, n):
        self.n = n
        self._cholesky = eigenpy.LLT(n)
        self._matrix = np.zeros((n, n))
        self._arrays = [np.zeros(n) for _ in range(6)]
        self._sign, self._least, self._most, self._lower, self._upper, self._slips = (
            _data(self._arrays[0], n), _data(self._arrays[1], n), _data(self._arrays[2], n),
            _data(self._arrays[3], n), _data(self._arrays[4], n), _data(self._arrays[5], n),
        )
        self.pivot()

    cpdef bound(self, p_positive, p_negative):
        cdef double *positive = _data(p_positive, self.n)
        cdef double *negative = _data(p_negative, self.n)
        cdef Py_ssize_t i
        for i in range(self.n):
            self._least[i], self._most[i] = -positive[i], negative[i]
        self.pivot()

    def slips_on(self, v):
        return self.slide_on(_data(v, self.n), NULL, 0.0)

    cdef bint slide_on(self, double *v, double *a, double dt) except -1:
        """Whether sliding joints with velocities v, or v + dt a, have not come to a stop."""
        cdef Py_ssize_t i
        for i in range(self.n):
            if (v[i] if a is NULL else v[i] + dt * a[i]) * self._sign[i] < 0.0:
                return False
        return True

    cpdef factorise(self, inertia):
        cdef Py_ssize_t i, k, n = self.n
        cdef double *given
        cdef double *matrix
        if not self.stuck:
            given, matrix = _data(inertia, n * n), _data(self._matrix, n * n)
            for i in range(n):  # rows and columns of joints that stick become those of the identity
                for k in range(n):
                    if self._slips[i] != 0.0 and self._slips[k] != 0.0:
                        matrix[i * n + k] = given[i * n + k]
                    else:
                        matrix[i * n + k] = 1.0 if i == k else 0.0
            self._cholesky.compute(self._matrix)
        self._factorised = inertia

    cpdef solve(self, inertia, momentum):
        cdef Py_ssize_t i, n = self.n, last, count, best = n + 1
        cdef int in_vain = 0, pivots
        cdef double *b = _data(momentum, n)
        cdef double *v
        cdef double *y
        cdef double free
        cdef object velocities = None, right = _vector(n), product
        cdef double *rhs = _data(right, n)
        cdef char[64] few
        cdef bytearray many = bytearray(n) if n > 64 else None
        cdef char *wrong = <char*>many if n > 64 else few
        cdef double[64] few_free
        cdef object frees = _vector(n)
        cdef double *f = _data(frees, n)
        for pivots in range(_MAX_PIVOTS):
            if self.stuck:
                velocities = np.zeros(n)
                for i in range(n):
                    f[i] = -b[i]
            else:
                if self._factorised is not inertia:
                    self.factorise(inertia)
                for i in range(n):
                    rhs[i] = (b[i] + self._impulse[i]) * self._slips[i]
                velocities = self._cholesky.solve(right).ravel()  # that of a single row comes as a matrix
                v, product = _data(velocities, n), inertia.dot(velocities)
                y = _data(product, n)
                for i in range(n):
                    f[i] = v[i] + (y[i] - b[i]) * (1.0 - self._slips[i])
            count, last = 0, 0
            for i in range(n):
                wrong[i] = f[i] > self._upper[i] or f[i] < self._lower[i]
                if wrong[i]:
                    count, last = count + 1, i
            if count == 0:
                break
            in_vain = 0 if count < best else in_vain + 1
            best = min(best, count)
            for i in range(n):
                if wrong[i] if in_vain < _BLOCKS_IN_VAIN else i == last:
                    if self._sign[i] == 0.0:
                        self._sign[i] = -1.0 if f[i] > 0.0 else 1.0 if f[i] < 0.0 else 0.0
                    else:
                        self._sign[i] = 0.0
            self.pivot()
        return velocities

    cdef pivot(self):
        """Assume which joints move forwards (1), backwards (-1) or stick (0)."""
        cdef Py_ssize_t i, sticking = 0
        cdef object impulse = _vector(self.n)
        cdef double sign
        self._impulse = _data(impulse, self.n)
        for i in range(self.n):
            sign = self._sign[i]
            self._slips[i] = fabs(sign)
            self._impulse[i] = self._least[i] if sign > 0.0 else self._most[i]
            if sign == 0.0:
                sticking += 1
                self._lower[i], self._upper[i] = self._least[i], self._most[i]
            else:
                self._lower[i] = 0.0 if sign > 0.0 else -INFINITY
                self._upper[i] = 0.0 if sign < 0.0 else INFINITY
        self.impulse, self._factorised = impulse, None
        self.stuck, self.all_slip = sticking == self.n, sticking == 0


cdef class Actuators:
    cdef object _dynamics, _tau_array, _viscous_array, _own_array, _limits_array, _brake_array
    cdef object _positive, _negative, _brakes, _held, _found, _found_for, _inertia, _bias, _momentum, _touch
    cdef DryFriction _friction
    cdef Py_ssize_t n
    cdef double _dt
    cdef double *_tau
    cdef double *_viscous
    cdef double *_own
    cdef double *_limits

    def __init__(self, cell, dynamics, dt):
        self._dynamics, self._dt = dynamics, dt
        self._viscous_array = cell.per_joint("viscous")
        n = self.n = len(self._viscous_array)
        self._own_array = cell.per_joint("rotor_inertia") + dt * self._viscous_array
        dynamics.reflect(self._own_array)
        self._positive, self._negative = cell.per_joint("coulomb_positive"), cell.per_joint("coulomb_negative")
        self._limits_array, self._brake_array = cell.per_joint("limits.torque"), cell.per_joint("brake")
        self._tau_array = np.zeros(n)
        self._tau, self._viscous = _data(self._tau_array, n), _data(self._viscous_array, n)
        self._own, self._limits = _data(self._own_array, n), _data(self._limits_array, n)
        self._friction = DryFriction(n)
        self.command(np.zeros(n), False, np.ones(n, dtype=np.bool_))

    def command(self, tau, power, brakes):
        cdef Py_ssize_t i
        cdef double *given = _data(tau, self.n)
        cdef double value
        for i in range(self.n):
            value = given[i] if power and isfinite(given[i]) else 0.0
            self._tau[i] = min(max(value, -self._limits[i]), self._limits[i])
        self._brakes = brakes
        held_now = brakes.tobytes()
        if held_now != self._held:
            self._held = held_now
            held = np.where(brakes, self._brake_array, 0.0)
            self._friction.bound(self._dt * (self._positive + held), self._dt * (self._negative + held))

    @property
    def brakes(self):
        return self._brakes

    @property
    def stuck(self):
        return self._friction.stuck

    def touch(self, torques):
        self._touch = torques

    def prepare(self, q, v):
        if self._friction.all_slip:
            return  # most likely M is not needed
        self.find_inertia(q, v)
        self._friction.factorise(self._inertia)

    def applied(self, q, v):
        cdef Py_ssize_t i, n = self.n
        cdef double dt = self._dt
        cdef object dynamics = self._dynamics, torques = _vector(n), a, work
        cdef DryFriction friction = self._friction
        cdef double *velocity = _data(v, n)
        cdef double *applied = _data(torques, n)
        cdef double *touch = NULL if self._touch is None else _data(self._touch, n)
        cdef double *acceleration
        cdef double *felt
        cdef double *bias
        cdef double *momentum
        cdef double *product
        cdef bint sliding = friction.all_slip
        if sliding:
            work = torques if touch is NULL else _vector(n)
            felt = _data(work, n)
            for i in range(n):
                applied[i] = (self._tau[i] + friction._impulse[i] / dt) - self._viscous[i] * velocity[i]
                if touch is not NULL:
                    felt[i] = applied[i] + touch[i]
            a = pin.aba(dynamics.model, dynamics.data, q, v, work, _WORLD)
            acceleration = _data(a, n)
            sliding = friction.slide_on(velocity, acceleration, dt)
        if sliding:
            for i in range(n):
                applied[i] = applied[i] - self._own[i] * acceleration[i]
        else:
            if self._found is not v or self._found_for is not dynamics.model:
                self.find_inertia(q, v)
            bias, momentum = _data(self._bias, n), _data(self._momentum, n)
            work = _vector(n)
            felt = _data(work, n)
            for i in range(n):
                felt[i] = (self._tau[i] - self._viscous[i] * velocity[i]) - bias[i]
                if touch is not NULL:
                    felt[i] += touch[i]
                felt[i] = momentum[i] + felt[i] * dt
            a = friction.solve(self._inertia, work)
            acceleration = _data(a, n)
            for i in range(n):
                acceleration[i] = (acceleration[i] - velocity[i]) / dt
            work = self._inertia.dot(a)
            product = _data(work, n)
            for i in range(n):
                applied[i] = (product[i] + bias[i]) - self._own[i] * acceleration[i]
                if touch is not NULL:
                    applied[i] -= touch[i]
        if dynamics.loaded:  # pybullet moves the arms without what the grippers hold
            work = pin.rnea(dynamics.bare, dynamics.bare_data, q, v, a)
            product = _data(work, n)
            for i in range(n):
                applied[i] = product[i] - self._own[i] * acceleration[i]
                if touch is not NULL:
                    applied[i] -= touch[i]
        return torques

    cdef find_inertia(self, q, v):
        """Find M, h and M v."""
        dynamics = self._dynamics
        self._inertia = pin.crba(dynamics.model, dynamics.data, q)
        self._bias = pin.nonLinearEffects(dynamics.model, dynamics.data, q, v)
        self._momentum = self._inertia.dot(v)
        self._found, self._found_for = v, dynamics.model


cdef object _WORLD = pin.Convention.WORLD
