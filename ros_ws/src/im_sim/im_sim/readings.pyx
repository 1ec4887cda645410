# Numbers of sensors, compiled; readings.pyi has the interface. Sums as in actuators.pyx.
from libc.math cimport cos, rint, sin

import numpy as np

cimport numpy as cnp

cnp.import_array()


cdef double* _data(object array, Py_ssize_t n) except NULL:
    """Numbers of an array of n numbers in a row."""
    if not cnp.PyArray_Check(array) or cnp.PyArray_TYPE(array) != cnp.NPY_FLOAT64:
        raise TypeError(f"{type(array).__name__} is no array of floats")
    if cnp.PyArray_SIZE(array) != n or not cnp.PyArray_IS_C_CONTIGUOUS(array):
        raise ValueError(f"an array has {cnp.PyArray_SIZE(array)} numbers, not {n} in a row")
    return <double*>cnp.PyArray_DATA(array)


cdef object _numbers(Py_ssize_t rows, Py_ssize_t columns):
    """Array of shape (rows, columns), or (rows,) for one column."""
    cdef cnp.npy_intp[2] shape
    shape[0], shape[1] = rows, columns
    return cnp.PyArray_EMPTY(1 if columns == 1 else 2, shape, cnp.NPY_FLOAT64, 0)


cdef class Readings:
    cdef Py_ssize_t _joints, _wrists, _jaws, n
    cdef double[:, ::1] _gear
    cdef double[::1] _resolution, _most

    def __init__(self, gear, resolution, most, wrists):
        self._gear = np.array(gear, dtype=np.float64)
        self._resolution, self._most = np.array(resolution, dtype=np.float64), np.array(most, dtype=np.float64)
        self.n, self._joints, self._wrists = len(resolution), len(gear), wrists
        self._jaws = self.n - self._joints - 6 * self._wrists
        if len(most) != self.n or self._jaws < 0 or self._gear.shape[1] != 4:
            raise ValueError("gears, resolutions and ranges are not as many as the signals")

    def told(self, q, wrench, force, noise):
        cdef Py_ssize_t i, joints = self._joints, of_wrists = 6 * self._wrists
        cdef object positions = _numbers(joints, 1), wrenches = _numbers(self._wrists, 6), forces = _numbers(self._jaws, 1)
        cdef double *off = _data(noise, self.n)
        cdef double *angle = _data(q, joints)
        cdef double *reading = _data(positions, joints)
        cdef double sine, cosine, twice
        for i in range(joints):  # a joint is off its encoder by one and two waves a turn of its gear
            sine, cosine = sin(angle[i]), cos(angle[i])
            twice = 2.0 * sine * (self._gear[i, 2] * cosine - self._gear[i, 3] * sine) + self._gear[i, 3]
            reading[i] = angle[i] - (self._gear[i, 0] * sine + self._gear[i, 1] * cosine + twice)
            reading[i] = self.quantised(i, reading[i] + off[i])
        self.part(joints, of_wrists, _data(wrench, of_wrists), off, _data(wrenches, of_wrists))
        joints += of_wrists
        self.part(joints, self._jaws, _data(force, self._jaws), off, _data(forces, self._jaws))
        return positions, wrenches, forces

    cdef void part(self, Py_ssize_t first, Py_ssize_t count, double *true, double *noise, double *told) noexcept:
        cdef Py_ssize_t i
        for i in range(count):
            told[i] = self.quantised(first + i, true[i] + noise[first + i])

    cdef double quantised(self, Py_ssize_t signal, double value) noexcept:
        """The nearest step of a signal, within its range."""
        cdef double most = self._most[signal]
        value = rint(value / self._resolution[signal]) * self._resolution[signal]
        value = -most if value < -most else value  # what is not a number stays so
        return most if value > most else value
