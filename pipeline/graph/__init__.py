"""From graph files to plans: loading, overlays, checks, editing, drawing."""
