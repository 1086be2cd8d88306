"""Everything inside a node process: operators, their runners, inputs and outputs."""
