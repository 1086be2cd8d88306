"""Transport between processes and its accounting: sessions, frame pools, ports, ledger."""
