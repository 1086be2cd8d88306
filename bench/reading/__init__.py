"""The text task: how many of a street's texts are read under a pixel budget."""
