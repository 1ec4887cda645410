"""Effects of a firing, all deterministic, for the replay of a journal.

| to learn | open |
|---|---|
| how tokens leave and outputs are marked, and what ends a job | :mod:`.rule` |
| what becomes of jobs whose tokens cross between nets | :mod:`.foreign_jobs` |
| what a journal is told, and how the journal repeats it | :mod:`.entries` |
| which jobs end as a net comes to rest | :mod:`.closing` |
"""
