"""The judge of what clients see: answers, feedback, results, states, and the order in which requests take effect."""
