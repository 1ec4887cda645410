"""The Data Object Manager (paper, section 6): stores and retrieves globally available data; knows ``im_core`` only.

:mod:`im_dom.store` keeps the objects; the node ``/dom`` in :mod:`im_dom.ros` is asked with
:class:`im_core.ros.dom.DomClient`. Nobody imports this package.
"""
