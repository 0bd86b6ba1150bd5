"""What a component is made of: ports, parameters, tables, links, faces; and the errors that all of halfshaft raises."""
