"""One net in execution: two-phase firing driven by events (paper, section 6), without ROS and without other nets.

| to learn | open |
|---|---|
| what a user of a net calls | :mod:`.executor` |
| how events are taken and firings follow, in one loop | :mod:`.event_loop`, :mod:`.events` |
| which transitions are enabled, and what a token carries | :mod:`.marking` |
| which of two enabled transitions fires | :mod:`.conflicts`, by the choice of :mod:`.strategies` |
| what a firing does, and how a journal repeats the firing | :mod:`.firing` |
| what it works for: commands, requests, the tape | :mod:`.jobs` |
| how actions are begun, ended and cancelled; what carries them out | :mod:`.actions`, :mod:`.runner` |
| what functions are told, in the loop and in threads | :mod:`.functions`, :mod:`.apart` |
| what becomes of an action of which nobody knows | :mod:`.doubt` |
| what is told to observers and to other nets; what to the journal | :mod:`.notification`, :mod:`.journal_entries` |
| time, and the operator; the last resort | :mod:`.timers`, :mod:`.operator`, :mod:`.abandonment` |
| how a new version of a net follows | :mod:`.succession` |
| values of an expression's names | :mod:`.values` |
"""
