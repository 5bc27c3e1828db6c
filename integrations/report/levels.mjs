// A level for the check: two rooms with a wall between them, one lit by a lamp, the other coloured and nearly dark.

const [ LENGTH, HEIGHT, DEPTH ] = [ 8, 3, 4 ];

/** The bytes of a .glb file. */
export function rooms() {

	const [ white, green, lamp ] = [ 0, 1, 2 ];
	const parts = [ white, green, lamp ].map( () => ( { positions: [], indices: [] } ) );
	// A rectangle from a corner along two edges; its front is where edge a × edge b points.
	const rectangle = ( part, corner, a, b ) => {

		const { positions, indices } = parts[ part ];
		const first = positions.length / 3;
		for ( const [ s, t ] of [ [ 0, 0 ], [ 1, 0 ], [ 1, 1 ], [ 0, 1 ] ] ) positions.push( ...corner.map( ( x, k ) => x + s * a[ k ] + t * b[ k ] ) );
		indices.push( first, first + 1, first + 2, first, first + 2, first + 3 );

	};

	const [ x, y, z ] = [ [ LENGTH / 2, 0, 0 ], [ 0, HEIGHT, 0 ], [ 0, 0, DEPTH ] ];
	for ( const [ part, left ] of [ [ white, 0 ], [ green, LENGTH / 2 ] ] ) {

		rectangle( part, [ left, 0, 0 ], z, x );
		rectangle( part, [ left, HEIGHT, 0 ], x, z );
		rectangle( part, [ left, 0, 0 ], x, y );
		rectangle( part, [ left, 0, DEPTH ], y, x );

	}

	rectangle( white, [ 0, 0, 0 ], y, z );
	rectangle( green, [ LENGTH, 0, 0 ], z, y );
	// The wall between them, thinner than the nodes are apart, with a door.
	for ( const [ part, at, flip ] of [ [ white, LENGTH / 2 - 0.05, true ], [ green, LENGTH / 2 + 0.05, false ] ] ) {

		const wall = ( corner, a, b ) => flip ? rectangle( part, corner, a, b ) : rectangle( part, corner, b, a );
		wall( [ at, 0, 0 ], [ 0, 0, 2.8 ], y );
		wall( [ at, 2.1, 2.8 ], [ 0, 0, 1.2 ], [ 0, 0.9, 0 ] );

	}

	rectangle( lamp, [ 1.5, HEIGHT - 0.02, 1.5 ], [ 1, 0, 0 ], [ 0, 0, 1 ] );
	const materials = [ { color: [ 0.8, 0.8, 0.8 ] }, { color: [ 0.2, 0.6, 0.25 ] }, { color: [ 0, 0, 0 ], emission: 12 } ].map( ( { color, emission } ) => ( {
		pbrMetallicRoughness: { baseColorFactor: [ ...color, 1 ], metallicFactor: 0 },
		...( emission ? { emissiveFactor: [ 1, 0.9, 0.8 ], extensions: { KHR_materials_emissive_strength: { emissiveStrength: emission } } } : {} ),
	} ) );
	const chunks = [];
	const document = { asset: { version: '2.0' }, extensionsUsed: [ 'KHR_materials_emissive_strength' ], scene: 0, scenes: [ { nodes: [ 0 ] } ], nodes: [ { mesh: 0 } ], meshes: [ { primitives: [] } ], materials, accessors: [], bufferViews: [] };
	let offset = 0;
	const add = ( array, accessor ) => {

		const bytes = Buffer.from( array.buffer );
		document.bufferViews.push( { buffer: 0, byteOffset: offset, byteLength: bytes.length } );
		document.accessors.push( { bufferView: document.bufferViews.length - 1, ...accessor } );
		chunks.push( bytes );
		offset += bytes.length;
		return document.accessors.length - 1;

	};

	parts.forEach( ( { positions, indices }, material ) => {

		const axis = ( k ) => positions.filter( ( _, i ) => i % 3 === k );
		const [ min, max ] = [ Math.min, Math.max ].map( ( of ) => [ 0, 1, 2 ].map( ( k ) => Math.fround( of( ...axis( k ) ) ) ) );
		const POSITION = add( Float32Array.from( positions ), { componentType: 5126, count: positions.length / 3, type: 'VEC3', min, max } );
		document.meshes[ 0 ].primitives.push( { attributes: { POSITION }, indices: add( Uint32Array.from( indices ), { componentType: 5125, count: indices.length, type: 'SCALAR' } ), material } );

	} );
	document.buffers = [ { byteLength: offset } ];
	let text = JSON.stringify( document );
	text += ' '.repeat( ( 4 - text.length % 4 ) % 4 );
	const head = ( ...words ) => Buffer.from( Uint32Array.from( words ).buffer );
	return Buffer.concat( [ head( 0x46546c67, 2, 12 + 8 + text.length + 8 + offset, text.length, 0x4e4f534a ), Buffer.from( text ), head( offset, 0x004e4942 ), ...chunks ] );

}
