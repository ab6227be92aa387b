"""What people look at: maps, belief panels, pictures of the physics, films."""
