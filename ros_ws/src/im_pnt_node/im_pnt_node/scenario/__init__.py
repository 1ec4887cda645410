"""Scenarios of nets: mocked answers, virtual time, expectations; ``pnt test`` and a plug-in of pytest run them.

A file (:mod:`.file`) is read, each scenario runs on the engine of the nodes in virtual time (:mod:`.run`) with answers
as written or drawn (:mod:`.draws`) and stand-ins for the rest (:mod:`.mocks`), and what happened (:mod:`.report`) is
compared with what is expected (:mod:`.verdict`).
"""
