# Fields of shared memory, copied all at once; fields.pyi has the interface.
from libc.string cimport memcpy

import numpy as np

cimport numpy as cnp

cnp.import_array()


cdef class Fields:
    cdef list _views
    cdef Py_ssize_t _count

    def __init__(self, views):
        self._views = [_checked(view) for view in views]
        self._count = len(self._views)

    def put(self, values):
        cdef Py_ssize_t k
        cdef object value
        cdef cnp.ndarray view
        if len(values) != self._count:
            raise ValueError(f"{len(values)} values are given for {self._count} fields")
        for k in range(self._count):
            view, value = <cnp.ndarray>self._views[k], values[k]
            if (
                cnp.PyArray_Check(value)
                and cnp.PyArray_TYPE(value) == cnp.PyArray_TYPE(view)
                and cnp.PyArray_IS_C_CONTIGUOUS(value)
                and cnp.PyArray_SAMESHAPE(value, view)
            ):
                memcpy(cnp.PyArray_DATA(view), cnp.PyArray_DATA(value), cnp.PyArray_NBYTES(view))
            elif cnp.PyArray_NDIM(view) == 0 and cnp.PyArray_TYPE(view) == cnp.NPY_INT64:
                (<cnp.int64_t*>cnp.PyArray_DATA(view))[0] = value
            else:
                view[...] = value

    def get(self):
        cdef Py_ssize_t k
        cdef cnp.ndarray view
        cdef object copy
        cdef list found = []
        for k in range(self._count):
            view = <cnp.ndarray>self._views[k]
            if cnp.PyArray_NDIM(view) == 0 and cnp.PyArray_TYPE(view) == cnp.NPY_INT64:
                found.append((<cnp.int64_t*>cnp.PyArray_DATA(view))[0])
            else:
                copy = cnp.PyArray_EMPTY(
                    cnp.PyArray_NDIM(view), cnp.PyArray_DIMS(view), cnp.PyArray_TYPE(view), 0
                )
                memcpy(cnp.PyArray_DATA(copy), cnp.PyArray_DATA(view), cnp.PyArray_NBYTES(view))
                found.append(copy)
        return tuple(found)


cdef object _checked(view):
    if not (isinstance(view, np.ndarray) and view.flags.c_contiguous):
        raise ValueError("a field is no array in a row")
    return view
