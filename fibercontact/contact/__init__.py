"""Contact: detection between fibres and obstacles, and assembly of the contact Jacobian."""
