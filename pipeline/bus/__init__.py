"""Bytes between processes and the accounts of them: keys, frame pool, ledger, ends of an edge."""
