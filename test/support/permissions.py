"""What a document of permissions allows, read as DDS Security 1.1 says: the first rule that fits counts."""

from fnmatch import fnmatchcase
from xml.etree import ElementTree as ET


def allowed(path, way, topic):
    """Whether a participant may ``publish`` or ``subscribe`` a topic of DDS."""
    grant = ET.parse(path).find("permissions/grant")
    for rule in grant:
        patterns = [pattern.text for pattern in rule.iterfind(f"{way}/topics/topic")]
        if rule.tag in ("allow_rule", "deny_rule") and any(fnmatchcase(topic, pattern) for pattern in patterns):
            return rule.tag == "allow_rule"
    return grant.find("default").text == "ALLOW"
