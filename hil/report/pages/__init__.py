"""HTML pages of the reports, a module for each kind of result; `page` renders them all by one template."""
