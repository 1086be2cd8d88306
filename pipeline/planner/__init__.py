"""Whether a graph's streams fit the link and the machine: a plan in, figures and verdicts out."""
