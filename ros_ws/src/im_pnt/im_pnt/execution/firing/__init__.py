"""Effects of a firing, all deterministic, for the replay of a journal.

| to learn | open |
|---|---|
| how tokens leave and outputs are marked, and what ends a job | :mod:`.rule` |
| what becomes of jobs whose tokens cross between nets | :mod:`.visits` |
| how a journal is told what happens, and how that is done again | :mod:`.happening` |
| which jobs end as a net comes to rest | :mod:`.rest` |
"""
