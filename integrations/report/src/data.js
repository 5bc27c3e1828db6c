// The data that gdibl put into the page: one JSON object, and blobs that it names by their numbers.

export const data = () => JSON.parse( document.getElementById( 'data' ).textContent );

/** The base64 text of a blob. */
export const blobText = ( id ) => document.getElementById( id === 'module' ? 'module' : `blob-${ id }` ).textContent;

/** Bytes from base64. */
export function bytesOf( text ) {

	if ( Uint8Array.fromBase64 ) return Uint8Array.fromBase64( text );
	const binary = atob( text );
	const bytes = new Uint8Array( binary.length );
	for ( let k = 0; k < bytes.length; k ++ ) bytes[ k ] = binary.charCodeAt( k );
	return bytes;

}

/** Floats from little-endian 16-bit floats. */
export function floatsOfHalves( bytes ) {

	const halves = new Uint16Array( bytes.buffer, bytes.byteOffset, bytes.length / 2 );
	return Float32Array.from( halves, ( bits ) => {

		const [ exponent, fraction ] = [ bits >> 10 & 31, bits & 1023 ];
		const size = exponent === 0 ? fraction * 2 ** - 24 : ( 1 + fraction / 1024 ) * 2 ** ( exponent - 15 );
		return bits >> 15 ? - size : size;

	} );

}
