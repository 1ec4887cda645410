"""What execution, analysis, remote places and the journal achieve, next to peers measured in the same run."""
