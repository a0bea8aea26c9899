"""The results of the comparison as tables."""
def markdown(results): return ""
