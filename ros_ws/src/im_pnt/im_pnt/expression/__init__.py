"""Expressions in net files, ``${arguments.width > 0.1}``: small, total and typed; nothing is given to ``eval``.

:mod:`~im_pnt.expression.syntax` reads them, :mod:`~im_pnt.expression.inference` finds their types,
:mod:`~im_pnt.expression.evaluation` their values, :mod:`~im_pnt.expression.template` does both for values with
expressions in them, and :mod:`~im_pnt.expression.scope` knows what names mean at a transition of a net. Types of
messages are looked up by who knows them (:class:`~im_pnt.expression.types.MessageTypes`); no ROS in here.
"""
