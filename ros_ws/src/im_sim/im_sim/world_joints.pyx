# Joint input and output of pybullet, compiled; world_joints.pyi has the interface.
#
# Bullet gives a plugin a client of the simulation that loads it (b3PluginContext.h). This module is such a plugin: the
# client takes the same commands as pybullet's functions, without a Python object for each number.
from posix.dlfcn cimport RTLD_NOW, dlopen, dlsym

import numpy as np
import pybullet

from im_core.errors import LinkError

cimport numpy as cnp

cnp.import_array()

ctypedef void *Handle


cdef struct PluginContext:
    Handle client


cdef struct ContactInformation:
    int count
    void *points


# functions of Bullet's C interface (PhysicsClientC_API.h)
cdef struct Bullet:
    Handle (*control)(Handle, int, int) noexcept
    int (*set_torque)(Handle, int, double) noexcept
    Handle (*step)(Handle) noexcept
    Handle (*request_state)(Handle, int) noexcept
    int (*state)(Handle, int*, int*, int*, double**, double**, double**, double**) noexcept
    Handle (*request_contacts)(Handle) noexcept
    void (*contacts_of)(Handle, int) noexcept
    void (*contacts)(Handle, ContactInformation*) noexcept
    int (*submit)(Handle, Handle) noexcept
    Handle (*status)(Handle) noexcept


cdef Bullet _bullet
cdef Handle _client = NULL  # of the simulation that the plugin was called in last
cdef int _version = pybullet.getAPIVersion()


cdef public int initPlugin(PluginContext *context) noexcept:
    return _version


cdef public int executePluginCommand(PluginContext *context, void *arguments) noexcept:
    global _client
    _client = context.client
    return 0


cdef public void exitPlugin(PluginContext *context) noexcept:
    pass


cdef void *_function(void *library, const char *name) except NULL:
    cdef void *found = dlsym(library, name)
    if found is NULL:
        raise LinkError(f"pybullet has no function {name.decode()}")
    return found


cdef int _find_functions() except -1:
    cdef bytes path = pybullet.__file__.encode()
    cdef void *library = dlopen(path, RTLD_NOW)
    if library is NULL:
        raise LinkError(f"pybullet cannot be opened: {pybullet.__file__}")
    (<void**>&_bullet.control)[0] = _function(library, b"b3JointControlCommandInit2")
    (<void**>&_bullet.set_torque)[0] = _function(library, b"b3JointControlSetDesiredForceTorque")
    (<void**>&_bullet.step)[0] = _function(library, b"b3InitStepSimulationCommand")
    (<void**>&_bullet.request_state)[0] = _function(library, b"b3RequestActualStateCommandInit")
    (<void**>&_bullet.state)[0] = _function(library, b"b3GetStatusActualState")
    (<void**>&_bullet.request_contacts)[0] = _function(library, b"b3InitRequestContactPointInformation")
    (<void**>&_bullet.contacts_of)[0] = _function(library, b"b3SetContactFilterBodyA")
    (<void**>&_bullet.contacts)[0] = _function(library, b"b3GetContactPointInformation")
    (<void**>&_bullet.submit)[0] = _function(library, b"b3SubmitClientCommand")
    (<void**>&_bullet.status)[0] = _function(library, b"b3ProcessServerStatus")
    return 0


_find_functions()


cdef class WorldJoints:
    cdef Handle _client
    cdef int _body, _torque_control
    cdef Py_ssize_t n
    cdef int[::1] _q_ranks, _v_ranks

    def __init__(self, client, body, joints):
        global _client
        _client = NULL
        pybullet.executePluginCommand(pybullet.loadPlugin(__file__, physicsClientId=client), physicsClientId=client)
        if _client is NULL:
            raise LinkError(f"pybullet does not load {__file__} as a plugin")
        self._client, self._body, self.n = _client, body, len(joints)
        self._torque_control = pybullet.TORQUE_CONTROL
        infos = [pybullet.getJointInfo(body, joint, client) for joint in joints]
        self._q_ranks = np.array([info[3] for info in infos], dtype=np.int32)
        self._v_ranks = np.array([info[4] for info in infos], dtype=np.int32)

    def step(self, const double[::1] tau):
        cdef Handle command
        cdef Py_ssize_t i
        if tau.shape[0] != self.n:
            raise ValueError(f"{tau.shape[0]} torques are given for {self.n} joints")
        command = _bullet.control(self._client, self._body, self._torque_control)
        for i in range(self.n):
            _bullet.set_torque(command, self._v_ranks[i], tau[i])
        self.submit(command)
        self.submit(_bullet.step(self._client))
        return self.state()

    cpdef tuple state(self):
        cdef cnp.npy_intp n = self.n
        cdef object positions = cnp.PyArray_EMPTY(1, &n, cnp.NPY_FLOAT64, 0)
        cdef object velocities = cnp.PyArray_EMPTY(1, &n, cnp.NPY_FLOAT64, 0)
        cdef double *q = <double*>cnp.PyArray_DATA(positions)
        cdef double *v = <double*>cnp.PyArray_DATA(velocities)
        cdef double *all_q
        cdef double *all_v
        cdef Py_ssize_t i
        cdef Handle status = self.submit(_bullet.request_state(self._client, self._body))
        if not _bullet.state(status, NULL, NULL, NULL, NULL, &all_q, &all_v, NULL):
            raise LinkError("pybullet does not give the state of the joints")
        for i in range(self.n):
            q[i], v[i] = all_q[self._q_ranks[i]], all_v[self._v_ranks[i]]
        return positions, velocities

    def touch(self):
        cdef ContactInformation found
        cdef Handle command = _bullet.request_contacts(self._client)
        _bullet.contacts_of(command, self._body)
        self.submit(command)
        _bullet.contacts(self._client, &found)
        return found.count > 0

    cdef Handle submit(self, Handle command) except NULL:
        """Have a command carried out; its status."""
        cdef Handle status
        _bullet.submit(self._client, command)
        status = _bullet.status(self._client)
        if status is NULL:
            raise LinkError("pybullet does not carry out a command")
        return status
