"""Write a workshop's files besides the solids: drawings as DXF and PDF, film patterns, moulds, lists and assembly order."""

# Imports inside functions: ezdxf, matplotlib and mpl_toolkits load only where sheets and pictures are drawn.
