"""Pictures of scenes and problems: stills, pages to turn about, animations."""
