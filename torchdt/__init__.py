"""Direct multiobject tracking in PyTorch, batched and differentiable."""
