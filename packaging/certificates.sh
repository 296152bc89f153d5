#!/usr/bin/env bash
# Makes the lab's own certificate authority, and a certificate for one robot, for zenoh-tls.json5.
#   certificates.sh FOLDER NAME [ADDRESS]
# makes FOLDER/ca.pem and ca.key if they do not exist yet, and NAME.pem and NAME.key for the robot NAME (or NAME.local) at ADDRESS. A
# robot gets ca.pem, its NAME.pem as robot.pem and its NAME.key as robot.key. Keep ca.key off the robots.
set -euo pipefail
folder=$1 name=$2 address=${3:-127.0.0.1} days=3650
mkdir -p "$folder"
cd "$folder"
umask 077
if [ ! -e ca.key ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days "$days" -keyout ca.key -out ca.pem \
        -subj "/CN=csi5300 robots" -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign" 2>&1
fi
openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -keyout "$name.key" -out "$name.csr" -subj "/CN=$name" 2>&1
openssl x509 -req -in "$name.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" -out "$name.pem" -extfile - 2>&1 <<END
basicConstraints=CA:FALSE
extendedKeyUsage=serverAuth,clientAuth
subjectAltName=DNS:$name,DNS:$name.local,IP:$address
END
rm -f "$name.csr"
