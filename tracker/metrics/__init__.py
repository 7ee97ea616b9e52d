"""How good an estimate is: errors, consistency, and the words for both."""
