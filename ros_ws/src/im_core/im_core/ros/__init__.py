"""Common parts of the ROS shells of all packages.

- :mod:`im_core.ros.node`: ``ManagedNode``, the base class of all tasks; :mod:`im_core.ros.run` spins them;
- :mod:`im_core.ros.guard`: ``GuardedNode``, base of every node, its action server and client: callbacks may raise;
  :mod:`im_core.ros.failures` counts what they raised;
- :mod:`im_core.ros.coroutines`, :mod:`im_core.ros.calls`: what a node's loop runs, and waiting with a time-out in it;
- :mod:`im_core.ros.heartbeats`, :mod:`im_core.ros.peers`: which task is alive, which nodes serve a name, and who asks;
- :mod:`im_core.ros.dom`: client of the Data Object Manager;
- :mod:`im_core.ros.messages`, :mod:`im_core.ros.qos`: types by name, plain data, errors; qualities of service.
"""

import sys

# What makes a type of ROS usable is in the package that generates such types, which does without its generators where
# they cannot be imported. They are a grammar of IDL and its parser, and no node generates anything.
sys.modules.setdefault("rosidl_generator_py.generate_py_impl", None)  # type: ignore[arg-type]  # None: no such module
