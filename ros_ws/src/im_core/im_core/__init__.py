"""What all packages of the Intelligent Machine share."""
