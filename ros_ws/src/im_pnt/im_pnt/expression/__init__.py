"""Expressions in net files, ``${arguments.width > 0.1}``: small, total and typed; nothing is given to ``eval``.

:mod:`~im_pnt.expression.syntax` reads them, :mod:`~im_pnt.expression.evaluation` finds their values, and
:mod:`~im_pnt.expression.template` those of values with expressions in them. When a net is loaded,
:mod:`~im_pnt.expression.inference` finds their types, and :mod:`~im_pnt.expression.scope` checks them, with what names
mean at a transition. Types of messages are looked up by who knows them
(:class:`~im_pnt.expression.types.MessageTypes`); no ROS in here.
"""
