"""How numbers and pictures of finished cells look: grids, colours, figures, pages."""
