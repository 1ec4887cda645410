"""ROS shell of the Petri net transducers: translates messages, decides nothing.

| to learn | open |
|---|---|
| what a node with nets is, and what its functions see of it | :mod:`.node`, :mod:`.node_host` |
| which nets it has, and how one replaces another | :mod:`.library`, :mod:`.loader` |
| what it executes | :mod:`.execution` |
| what is asked of it | :mod:`.commands` |
| what its nets see of the machine | :mod:`.objects` |
| what it tells, and what missions are run again from | :mod:`.reporting` |
| messages and plain data; messages as bytes | :mod:`.messages`, :mod:`.cdr` |
| the programs | :mod:`.net_runner`, :mod:`.rerun` |
"""
