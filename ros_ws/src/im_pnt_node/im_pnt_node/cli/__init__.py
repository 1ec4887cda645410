"""Commands of ``pnt`` with journals or an exchange: ``journal`` and ``bench``."""
