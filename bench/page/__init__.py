"""All benchmarks in one table, and the page in ``docs/`` that shows the latest."""
