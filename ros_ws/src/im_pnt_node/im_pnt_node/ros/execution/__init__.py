"""Execution in a node: the loop of the nets, and the work of the transitions with other tasks and nets.

| to learn | open |
|---|---|
| in which order events, firings, journal and effects follow each other | :mod:`.loop` |
| how packets of tokens and requests leave and arrive | :mod:`.transport` |
| who does the action of a transition | :mod:`.runner`, :mod:`.endpoints` |
| services, topics and awaited messages; action goals | :mod:`.actions`, :mod:`.awaits`, :mod:`.goals` |
"""
