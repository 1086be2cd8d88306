"""Generated input against everything that reads what comes from outside."""
