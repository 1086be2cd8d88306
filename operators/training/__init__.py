"""What several trainings share. Nothing that runs live imports it."""
