"""Committed result files, and the page that is made of them (`bench/RESULTS.md`)."""
