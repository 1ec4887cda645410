# A few numbers at a time, compiled; vectors.pyi has the interface.
from libc.math cimport fabs, isfinite

cimport numpy as cnp

cnp.import_array()


cdef object _vector(Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    return cnp.PyArray_EMPTY(1, &shape, cnp.NPY_FLOAT64, 0)


def all_finite(const double[:] x):
    cdef Py_ssize_t i
    for i in range(x.shape[0]):
        if not isfinite(x[i]):
            return False
    return True


def any_beyond(const double[:] x, const double[:] bounds):
    cdef Py_ssize_t i
    if x.shape[0] != bounds.shape[0]:
        raise ValueError(f"{x.shape[0]} numbers have {bounds.shape[0]} bounds")
    for i in range(x.shape[0]):
        if fabs(x[i]) > bounds[i]:
            return True
    return False


def clip(const double[:] x, const double[:] low, const double[:] high):
    cdef Py_ssize_t i, n = x.shape[0]
    cdef object clipped = _vector(n)
    cdef double *found = <double*>cnp.PyArray_DATA(clipped)
    cdef double value
    if not n == low.shape[0] == high.shape[0]:
        raise ValueError(f"{n} numbers have {low.shape[0]} and {high.shape[0]} bounds")
    for i in range(n):
        value = low[i] if x[i] < low[i] else x[i]  # what is not a number stays so
        found[i] = high[i] if value > high[i] else value
    return clipped
