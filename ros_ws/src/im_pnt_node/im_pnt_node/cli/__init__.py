"""Commands of ``pnt`` that need journals or an exchange: ``journal`` and ``bench``."""
