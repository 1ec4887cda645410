# Numbers of sensors, compiled; readings.pyi has the interface. Sums as in actuators.pyx.
from libc.math cimport rint

cimport numpy as cnp

cnp.import_array()


cdef object _vector(Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_FLOAT64, 0)


def joint_readings(tuple states):
    cdef Py_ssize_t i, n = len(states)
    cdef object positions = _vector(n), velocities = _vector(n)
    cdef double *q = <double*>cnp.PyArray_DATA(positions)
    cdef double *v = <double*>cnp.PyArray_DATA(velocities)
    cdef tuple state
    for i in range(n):
        state = <tuple?>states[i]
        q[i], v[i] = state[0], state[1]
    return positions, velocities


def quantised(
    const double[::1] true, const double[::1] noise, const double[::1] resolution,
    const double[::1] least, const double[::1] most,
):
    cdef Py_ssize_t i, n = true.shape[0]
    cdef object told = _vector(n)
    cdef double *reading = <double*>cnp.PyArray_DATA(told)
    cdef double value
    if not n == noise.shape[0] == resolution.shape[0] == least.shape[0] == most.shape[0]:
        raise ValueError("signals, noise, resolutions and ranges are not as many")
    for i in range(n):
        value = rint((true[i] + noise[i]) / resolution[i]) * resolution[i]
        value = least[i] if value < least[i] else value  # what is not a number stays so
        reading[i] = most[i] if value > most[i] else value
    return told
