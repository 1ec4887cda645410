"""Decision of guards over values: arguments, answers, failures, and data objects that the net itself stores."""
