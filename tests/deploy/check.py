"""Checks what is in deploy/ with the schemas of those who read it. Usage: check.py ROOT COMPOSE_SCHEMA OUT

The configuration inside of the Kubernetes manifests is written to OUT, for the daemon's own check.
"""

import json
import sys
from pathlib import Path

import jsonschema
import kubernetes_validate
import yaml
from yamllint import linter
from yamllint.config import YamlLintConfig

root, schema, out = (Path(argument) for argument in sys.argv[1:4])
deploy = root / "deploy"
# The oldest and the newest release for which the manifests are to be good.
VERSIONS = ["1.29", kubernetes_validate.latest_version()]
LINT = YamlLintConfig("{extends: default, rules: {line-length: {max: 160}, document-start: disable, braces: {max-spaces-inside: 0}, truthy: {check-keys: false}}}")


def check(condition, what):
    if not condition:
        sys.exit(f"wrong: {what}")
    print(f"ok: {what}")


def lint():
    files = sorted(deploy.rglob("*.y*ml"))
    found = [f"{file.relative_to(root)}:{problem.line}: {problem.desc}" for file in files for problem in linter.run(file.read_text(), LINT)]
    check(not found and len(files) >= 8, f"{len(files)} YAML files are clean {found or ''}")


def compose():
    text = yaml.safe_load((deploy / "compose.yml").read_text())
    jsonschema.validate(text, json.loads(schema.read_text()))
    try:
        jsonschema.validate({"services": {"a": {"no_such_key": 1}}}, json.loads(schema.read_text()))
        sys.exit("wrong: the schema takes everything")
    except jsonschema.ValidationError:
        pass
    for name, service in text["services"].items():
        hard = service["read_only"] and service["cap_drop"] == ["ALL"] and "no-new-privileges:true" in service["security_opt"]
        check(hard and service["mem_limit"] and service["pids_limit"], f"{name} is bounded and may nothing")
        check("build" in service or ":v" in service["image"], f"{name} names the version of its image")
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            known = (deploy / source).exists() if source.startswith(".") else source in text["volumes"]
            check(known, f"{name} mounts {source}, which is there")


def kubernetes():
    folder = deploy / "kubernetes"
    listed = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
    files = sorted(file.name for file in folder.glob("*.yaml") if file.name != "kustomization.yaml")
    check(sorted(listed) == files, f"the kustomization lists {files}")
    kinds = {}
    for name in files:
        for manifest in yaml.safe_load_all((folder / name).read_text()):
            for version in VERSIONS:
                kubernetes_validate.validate(manifest, version, strict=True)
            check(manifest["kind"] not in kinds, f"{name}: {manifest['kind']} is valid for {VERSIONS}")
            kinds[manifest["kind"]] = manifest
    try:
        kubernetes_validate.validate({**kinds["Service"], "spec": {"prots": []}}, VERSIONS[0], strict=True)
        sys.exit("wrong: the schema takes everything")
    except kubernetes_validate.ValidationError:
        pass
    check(set(kinds) == {"Namespace", "ConfigMap", "NetworkPolicy", "Service", "StatefulSet"}, "nothing is missing")
    check(kinds["Namespace"]["metadata"]["labels"]["pod-security.kubernetes.io/enforce"] == "restricted", "the namespace is restricted")
    owned = [kind for kind in kinds if kind != "Namespace"]
    check(all(kinds[kind]["metadata"]["namespace"] == "stictiond" for kind in owned), "everything is in one namespace")
    pod = kinds["StatefulSet"]["spec"]["template"]
    for kind, selector in (("Service", kinds["Service"]["spec"]["selector"]), ("NetworkPolicy", kinds["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"]), ("StatefulSet", kinds["StatefulSet"]["spec"]["selector"]["matchLabels"])):
        check(selector.items() <= pod["metadata"]["labels"].items(), f"{kind} means the pod")
    check(set(kinds["NetworkPolicy"]["spec"]["policyTypes"]) == {"Ingress", "Egress"}, "both ways are closed but for what is listed")
    spec, (container,) = pod["spec"], pod["spec"]["containers"]
    own = container["securityContext"]
    check(spec["securityContext"]["runAsNonRoot"] and spec["securityContext"]["seccompProfile"]["type"] == "RuntimeDefault" and not spec["automountServiceAccountToken"], "the pod is nobody, without a token")
    check(own["readOnlyRootFilesystem"] and not own["allowPrivilegeEscalation"] and own["capabilities"]["drop"] == ["ALL"], "the container may nothing, on a root that is read-only")
    check(set(container["resources"]) == {"requests", "limits"} and all("memory" in one for one in container["resources"].values()), "it is bounded")
    check(all(probe in container for probe in ("startupProbe", "livenessProbe", "readinessProbe")), "it is asked whether it lives")
    names = {volume["name"] for volume in spec["volumes"]} | {claim["metadata"]["name"] for claim in kinds["StatefulSet"]["spec"]["volumeClaimTemplates"]}
    check({mount["name"] for mount in container["volumeMounts"]} == names, f"{sorted(names)} are there and mounted")
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    check(kinds["Service"]["spec"]["ports"][0]["targetPort"] in ports, "the service leads to a port of it")
    told = kinds["ConfigMap"]["data"]["stictiond.toml"]
    check(f":{ports['https']}\"" in told, "the configuration listens on that port")
    (out / "kubernetes.toml").write_text(told)


lint()
compose()
kubernetes()
