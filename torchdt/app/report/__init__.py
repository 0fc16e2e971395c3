"""What a run leaves behind: files, figures, TensorBoard events and a closing table."""
