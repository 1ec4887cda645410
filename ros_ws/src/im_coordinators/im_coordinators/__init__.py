"""The four Coordinators (paper, section 6): experts of motion, grippers, vision and path planning.

A Coordinator is a net of fixed structure in ``nets/``, a module here with what it decides (that of grippers decides
nothing), and a node in ``ros/`` that translates. They know the nets (``im_pnt``, ``im_pnt_analysis``), the cell
(``im_cell``), how the calibration judges measurements (``im_calibration``), and shapes and limits of ``im_mcs``; the
Dispatcher, MCS and VSS by messages only. Nobody imports this package.
"""
