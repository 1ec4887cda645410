"""Common base of all packages, independent of all packages.

- :mod:`im_core.errors`: the tree of errors, each with its facts;
- :mod:`im_core.config`, :mod:`im_core.text`: YAML and JSON into frozen, typed models, with file, line and column;
- :mod:`im_core.clock`, :mod:`im_core.stopwatch`: the only place that reads the wall clock; where time goes;
- :mod:`im_core.names`, :mod:`im_core.files`: names and folders of a machine, files written whole;
- :mod:`im_core.plugins`: the loader of ``module:Class``, and of public names at their first use;
- :mod:`im_core.processes`: child processes, what those of the real-time chain ask for, the start-up and its phases;
- :mod:`im_core.shm`: shared memory and semaphores;
- :mod:`im_core.ros`: base class of all nodes, and what they wait with.
"""
