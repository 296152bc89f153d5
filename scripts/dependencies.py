"""Checks the crates of all features against deny.toml: licences, and several versions of one crate.

Does the work of `cargo deny check licenses bans` on machines without it; advisories need that program and its database (tests/checks/deny.sh).
"""

import collections
import json
import re
import subprocess
import sys
import tomllib


def allowed(expression, licences):
    """An SPDX expression over `licences`; "/" is the old notation for OR."""
    tokens = re.findall(r"\(|\)|[^\s()]+", expression.replace("/", " OR "))

    def primary(at):
        if tokens[at] == "(":
            value, at = alternatives(at + 1)
            return value, at + 1
        name, at = tokens[at], at + 1
        if at + 1 < len(tokens) and tokens[at] == "WITH":
            # A licence with an exception permits more than without it.
            return name in licences or f"{name} WITH {tokens[at + 1]}" in licences, at + 2
        return name in licences, at

    def together(at):
        value, at = primary(at)
        while at < len(tokens) and tokens[at] == "AND":
            other, at = primary(at + 1)
            value = value and other
        return value, at

    def alternatives(at):
        value, at = together(at)
        while at < len(tokens) and tokens[at] == "OR":
            other, at = together(at + 1)
            value = value or other
        return value, at

    return alternatives(0)[0]


def below(graph, name_of, roots):
    """The packages that `roots` (names) depend on, and themselves."""
    found, waiting = set(), [package for package, name in name_of.items() if name in roots]
    while waiting:
        package = waiting.pop()
        if package not in found:
            found.add(package)
            waiting.extend(graph[package])
    return found


def main():
    with open("deny.toml", "rb") as file:
        rules = tomllib.load(file)
    packages, graph = {}, collections.defaultdict(set)
    for target in rules["graph"]["targets"]:
        command = ["cargo", "metadata", "--format-version", "1", "--locked", "--all-features", "--filter-platform", target]
        said = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        nodes = {node["id"]: node for node in said["resolve"]["nodes"]}
        packages.update({package["id"]: package for package in said["packages"] if package["id"] in nodes})
        for package, node in nodes.items():
            graph[package].update(node["dependencies"])
    problems = []

    exceptions = {rule["crate"]: rule["allow"] for rule in rules["licenses"]["exceptions"]}
    for package in packages.values():
        licences = set(rules["licenses"]["allow"]) | set(exceptions.get(package["name"], []))
        if not allowed(package["license"] or "none", licences):
            problems.append(f"licence of {package['name']} {package['version']}: {package['license']}")

    name_of = {package: data["name"] for package, data in packages.items()}
    skipped = {rule["crate"] for rule in rules["bans"].get("skip", [])}
    under = below(graph, name_of, {rule["crate"] for rule in rules["bans"].get("skip-tree", [])})
    versions = collections.defaultdict(set)
    for package, data in packages.items():
        if package not in under:
            versions[data["name"]].add(data["version"])
    for name, found in sorted(versions.items()):
        if len(found) > 1 and name not in skipped:
            problems.append(f"{name} in {len(found)} versions: {', '.join(sorted(found))}")
    known = set(name_of.values())
    for kind in ["skip", "skip-tree"]:
        problems += [f"{kind} names {rule['crate']}, which nothing uses" for rule in rules["bans"].get(kind, []) if rule["crate"] not in known]

    print(f"{len(packages)} packages with all features, {len(problems)} problems")
    sys.exit("\n".join(problems) or 0)


if __name__ == "__main__":
    main()
