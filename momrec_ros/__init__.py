"""momrec_ros: everything that meets the outside: messages, bags, command line, figures, node."""
