"""Content of a net file: models for the check, and the source of the JSON schema for editors.

| to learn | open |
|---|---|
| which names things may have | :mod:`.names` |
| how a value is read as it is written; which values there are | :mod:`.scalars`, :mod:`.values` |
| what is said of a place, of a transition | :mod:`.places`, :mod:`.transitions` |
| which actions there are, and how long they take | :mod:`.actions`, :mod:`.delays` |
| which commands and services there are, and what they take | :mod:`.commands` |
| what is copied, and the whole file | :mod:`.templates`, :mod:`.net` |
"""
