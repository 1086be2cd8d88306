"""What runs in the process of a node: the operator between its inputs and outputs."""
